from pathlib import Path

import numpy as np
import pytest
from scenes.networks import HEIGHT, WIDTH, changed, write_classifier, write_depth_network

from ltm_core.base.errors import ModelError
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.geometry.camera import Camera
from ltm_core.vision.segmenter import Segmenter

CAMERA = Camera(WIDTH * 3, HEIGHT * 2, 120.0, 100.0, 70.0, 33.0)


def test_no_numbers_and_no_metres_become_nan(tmp_path: Path) -> None:
    photo = np.random.default_rng(1).integers(0, 256, (CAMERA.height, CAMERA.width, 3), np.uint8)
    for kind, values in (("relative_inverse", "nan"), ("metric", "negative")):
        found = DepthNetwork.open(write_depth_network(tmp_path, kind, values)).predict(photo, CAMERA)
        assert np.isnan(found.values).all()


def test_what_is_no_depth_network_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"'colors'.*`model`"):
        DepthNetwork.open(write_classifier(tmp_path))
    with pytest.raises(ModelError, match=r"'depth'.*`depth_model`"):
        Segmenter.open(write_depth_network(tmp_path))
    labels_as_depth = changed(write_depth_network(tmp_path, two_heads=True), output={"name": "scores"})
    with pytest.raises(ModelError, match=r"found \[1, 5, 32, 48\]"):
        DepthNetwork.open(labels_as_depth)
