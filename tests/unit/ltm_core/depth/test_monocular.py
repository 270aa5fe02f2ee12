"""Depth networks behind manifests: kinds, focal lengths, heads, and outputs that are no depth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes.networks import (
    COLORS,
    HEIGHT,
    MAPPING,
    WIDTH,
    changed,
    write_classifier,
    write_depth_network,
    write_manifest,
)

from ltm_core.base.errors import ImageError, ModelError
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.depth.monocular import DepthNetwork, NetworkDepth
from ltm_core.geometry.camera import Camera
from ltm_core.vision.manifest import MODEL_PATH_VARIABLE, NetworkManifest
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


@pytest.mark.parametrize("kind", ["relative_inverse", "affine_invariant"])
def test_relative_kinds_come_as_the_network_gives_them(tmp_path: Path, kind: str) -> None:
    depth = DepthNetwork.open(write_depth_network(tmp_path, kind)).predict(photo(), CAMERA)
    assert depth.kind == kind
    np.testing.assert_allclose(depth.values, green_at_network(), atol=0.003)


def test_metres_follow_the_focal_length_of_the_network_input(tmp_path: Path) -> None:
    path = write_depth_network(tmp_path, output={"kind": "metric", "name": "depth", "canonical_focal_px": 10.0})
    depth = DepthNetwork.open(path).predict(photo(), CAMERA)
    # 120 px over a third of the width is 40; the vertical 50 px do not count, as the photo is stretched.
    np.testing.assert_allclose(depth.values, green_at_network() * 40.0 / 10.0, rtol=0.02)


def test_inverse_metres_are_turned_over(tmp_path: Path) -> None:
    output = {"kind": "metric", "name": "depth", "inverse": True, "canonical_focal_px": WIDTH}
    depth = DepthNetwork.open(write_depth_network(tmp_path, output=output)).predict(photo(), CAMERA)
    np.testing.assert_allclose(depth.values, 40.0 / WIDTH / green_at_network(), rtol=0.02)


def test_a_network_that_wants_the_camera_matrix_gets_it_in_its_own_pixels(tmp_path: Path) -> None:
    path = write_depth_network(tmp_path, "metric", intrinsics=True)
    depth = DepthNetwork.open(path).predict(photo(), CAMERA)
    np.testing.assert_allclose(depth.values, 40.0 * green_at_network(), rtol=0.02)


def test_one_file_serves_labels_and_depth(tmp_path: Path) -> None:
    depth_path = write_depth_network(tmp_path, two_heads=True)
    content = NetworkManifest.load(depth_path).model_dump(mode="json")
    labels = content | {
        "output": {"kind": "logits", "name": "scores"},
        "classes": list(COLORS),
        "mapping": MAPPING,
        "name": "labels",
    }
    label_path = write_manifest(tmp_path / "labels.yaml", labels)
    depth = DepthNetwork.open(depth_path).predict(photo(), CAMERA)
    assert depth.values.shape == (HEIGHT, WIDTH)
    assert Segmenter.open(label_path).segment(photo()).labels.shape == (CAMERA.height, CAMERA.width)


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


def test_a_photo_of_another_size_than_the_camera_is_refused(tmp_path: Path) -> None:
    network = DepthNetwork.open(write_depth_network(tmp_path))
    with pytest.raises(ImageError, match=r"photo of \(64, 143, 3\) uint8 does not fit a camera of 144 x 64"):
        network.predict(photo()[:, 1:], CAMERA)


def test_depth_must_be_an_image_of_a_known_kind() -> None:
    with pytest.raises(ImageError, match="kind 'disparity'"):
        NetworkDepth(np.ones((3, 4), np.float32), "disparity")  # type: ignore[arg-type]
    with pytest.raises(ImageError, match=r"got shape \(4,\)"):
        NetworkDepth(np.ones(4, np.float32), "metric")


def test_tcmonodepth_sees_that_the_ground_below_is_nearer_than_the_sky(
    shared_models: Path, shared_data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import cv2

    monkeypatch.setenv(MODEL_PATH_VARIABLE, str(shared_models))
    image = cv2.imread(str(shared_data / "engabreen" / "IMG_8902.jpg"))
    assert image is not None
    rgb = np.ascontiguousarray(cv2.resize(image, (960, 640))[..., ::-1])
    values = DepthNetwork.open("tcmonodepth").predict(rgb, Camera.from_fov(960, 640, 40.0)).values
    assert values.shape == (256, 384)
    assert np.median(values[-40:]) > np.median(values[100:140]) > np.median(values[:20])
