from pathlib import Path

import numpy as np
import pytest
from scenes.networks import HEIGHT, WIDTH, changed, write_classifier, write_depth_network

from ltm_core.base.errors import ModelError
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.geometry.camera import Camera
from ltm_core.vision.segmenter import Segmenter

CAMERA = Camera(WIDTH * 3, HEIGHT * 2, 120.0, 100.0, 70.0, 33.0)


def photo() -> UInt8Array:
    """Green grows to the right and downwards, unevenly."""
    rows, cols = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    green = 20 + cols + rows // 2
    return np.stack([np.full_like(green, 90), green, np.full_like(green, 7)], axis=-1).astype(np.uint8)


def green_at_network() -> Float32Array:
    blocks = photo()[..., 1].reshape(HEIGHT, 2, WIDTH, 3).astype(np.float64)
    return np.asarray(blocks.mean(axis=(1, 3)) / 255.0, np.float32)


def test_metres_follow_the_focal_length_of_the_network_input(tmp_path: Path) -> None:
    path = write_depth_network(tmp_path, output={"kind": "metric", "name": "depth", "canonical_focal_px": 10.0})
    depth = DepthNetwork.open(path).predict(photo(), CAMERA)
    # 120 px over a third of the width is 40; the vertical 50 px do not count, as the photo is stretched.
    np.testing.assert_allclose(depth.values, green_at_network() * 40.0 / 10.0, rtol=0.02)


def test_a_network_that_wants_the_camera_matrix_gets_it_in_its_own_pixels(tmp_path: Path) -> None:
    path = write_depth_network(tmp_path, "metric", intrinsics=True)
    depth = DepthNetwork.open(path).predict(photo(), CAMERA)
    np.testing.assert_allclose(depth.values, 40.0 * green_at_network(), rtol=0.02)


def test_no_numbers_and_no_metres_become_nan(tmp_path: Path) -> None:
    broken = DepthNetwork.open(write_depth_network(tmp_path, values="nan")).predict(photo(), CAMERA)
    assert np.isnan(broken.values).all()
    below = DepthNetwork.open(write_depth_network(tmp_path, "metric", values="negative")).predict(photo(), CAMERA)
    assert np.isnan(below.values).all()


def test_what_is_no_depth_network_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"'colors'.*`model`"):
        DepthNetwork.open(write_classifier(tmp_path))
    with pytest.raises(ModelError, match=r"'depth'.*`depth_model`"):
        Segmenter.open(write_depth_network(tmp_path))
    labels_as_depth = changed(write_depth_network(tmp_path, two_heads=True), output={"name": "scores"})
    with pytest.raises(ModelError, match=r"found \[1, 5, 32, 48\]"):
        DepthNetwork.open(labels_as_depth)
