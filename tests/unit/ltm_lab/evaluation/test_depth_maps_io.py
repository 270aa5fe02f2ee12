"""Depth maps of others: files, units, sizes, and the fit of those without a scale."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from ltm_core.base.errors import ConfigError, ImageError
from ltm_core.geometry.camera import Camera
from ltm_lab.evaluation.depth.depth_maps_io import DepthMapFolder
from ltm_lab.evaluation.metrics.depth_fit import at_pixels_of, fit_to_truth

TRUTH = np.array([[40.0, 80.0, np.inf], [100.0, 250.0, 500.0]], np.float32)


def test_fit_of_inverse_depth() -> None:
    values = np.where(np.isfinite(TRUTH), 3000 / TRUTH - 7, 99).astype(np.float32)
    fitted = fit_to_truth(values, TRUTH, "relative_inverse")
    known = np.isfinite(TRUTH)
    np.testing.assert_allclose(fitted[known], TRUTH[known], rtol=1e-4)
    behind = fit_to_truth(np.where(known, values, -50).astype(np.float32), TRUTH, "relative_inverse")
    assert behind[0, 2] == 500  # beyond infinity: held at the largest true depth


def test_fit_of_affine_depth_and_of_metres() -> None:
    values = (TRUTH / 12 + 3).astype(np.float32)
    known = np.isfinite(TRUTH)
    np.testing.assert_allclose(fit_to_truth(values, TRUTH, "affine_invariant")[known], TRUTH[known], rtol=1e-5)
    np.testing.assert_array_equal(fit_to_truth(values, TRUTH, "metric"), values)
    with pytest.raises(ImageError, match="cannot be fitted"):
        fit_to_truth(values, TRUTH.T, "metric")


def test_pixels_of_a_sampled_truth() -> None:
    rows, cols = np.indices((10, 18), np.float32)
    depth = 100 * rows + cols
    np.testing.assert_array_equal(at_pixels_of(depth, (10, 18), (3, 5)), depth[::4, ::4])
    np.testing.assert_array_equal(at_pixels_of(depth[::4, ::4], (10, 18), (3, 5)), depth[::4, ::4])
    twice = np.repeat(np.repeat(depth, 2, axis=0), 2, axis=1)
    np.testing.assert_array_equal(at_pixels_of(twice, (10, 18), (3, 5)), depth[::4, ::4])
    half = depth[::2, ::2]  # (5, 9): its pixel covers two of the image's
    np.testing.assert_array_equal(at_pixels_of(half, (10, 18), (3, 5)), depth[::4, ::4])
    with pytest.raises(ImageError, match=r"\(4, 5\) is no sampling of an image of \(10, 18\)"):
        at_pixels_of(depth, (10, 18), (4, 5))


def read(folder: DepthMapFolder, camera: str, stamp: int) -> np.ndarray | None:
    return folder.of_frame(camera, stamp, (1, 3), None)


def test_files(tmp_path: Path) -> None:
    depth = np.array([[1.5, np.inf, 2.25]], np.float32)
    (tmp_path / "north").mkdir()
    np.save(tmp_path / "north/7.npy", depth[None])
    cv2.imwrite(str(tmp_path / "east_8.tif"), depth)
    folder = DepthMapFolder.open("unidepth", tmp_path)
    np.testing.assert_array_equal(read(folder, "north", 7), depth)
    np.testing.assert_array_equal(read(folder, "east", 8), depth)
    assert read(folder, "east", 7) is None
    np.save(tmp_path / "east_9.npy", np.zeros((2, 3, 3)))
    with pytest.raises(ImageError, match="one number a pixel"):
        read(folder, "east", 9)
    (tmp_path / "east_10.npy").write_bytes(b"none")
    with pytest.raises(ImageError, match=r"east_10\.npy is damaged"):
        read(folder, "east", 10)


def test_integers_need_a_unit(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "north_7.png"), np.array([[0, 12, 65535]], np.uint16))
    with pytest.raises(ImageError, match=r"metres_per_unit.*depth_maps.yaml"):
        read(DepthMapFolder.open("a", tmp_path), "north", 7)
    (tmp_path / "depth_maps.yaml").write_text("metres_per_unit: 0.5\nkind: affine_invariant\n")
    folder = DepthMapFolder.open("a", tmp_path)
    assert folder.config.kind == "affine_invariant"
    np.testing.assert_array_equal(read(folder, "north", 7), [[np.nan, 6, 32767.5]])
    (tmp_path / "depth_maps.yaml").write_text("metres: 1\n")
    with pytest.raises(ConfigError, match="unknown key"):
        DepthMapFolder.open("a", tmp_path)
    (tmp_path / "none").mkdir()
    with pytest.raises(ImageError, match="holds no depth map"):
        DepthMapFolder.open("a", tmp_path / "none")
    with pytest.raises(ImageError, match="nowhere: no such folder"):
        DepthMapFolder.open("a", tmp_path / "nowhere")


def test_ranges_along_rays_come_to_the_axis(tmp_path: Path) -> None:
    camera = Camera.from_fov(12, 8, 70.0)
    depth = np.full((8, 12), 50.0, np.float32)
    np.save(tmp_path / "north_7.npy", depth / camera.rays()[..., 2])
    np.save(tmp_path / "north_8.npy", (depth / camera.rays()[..., 2])[::4, ::4])
    (tmp_path / "depth_maps.yaml").write_text("along: ray\n")
    folder = DepthMapFolder.open("lidar", tmp_path)
    found = folder.of_frame("north", 7, (8, 12), camera)
    assert found is not None
    np.testing.assert_allclose(found, depth, rtol=1e-6)
    smaller = folder.of_frame("north", 8, (8, 12), camera)
    assert smaller is not None
    assert smaller.shape == (2, 3)
    with pytest.raises(ImageError, match="nothing says the camera"):
        folder.of_frame("north", 7, (8, 12), None)
    (tmp_path / "depth_maps.yaml").write_text("along: ray\nkind: relative_inverse\n")
    with pytest.raises(ConfigError, match="along: ray needs kind: metric"):
        DepthMapFolder.open("lidar", tmp_path)


def test_a_map_that_lies_on_its_side_is_refused(tmp_path: Path) -> None:
    for stamp, shape in enumerate([(12, 8), (120, 80), (8, 12), (10, 10), (24, 30)]):
        np.save(tmp_path / f"north_{stamp}.npy", np.ones(shape, np.float32))
    folder = DepthMapFolder.open("a", tmp_path)
    for stamp, rows in ((0, 12), (1, 120)):
        with pytest.raises(ImageError, match=f"{rows} rows of .* lie on their side; the image has 8 of 12"):
            folder.of_frame("north", stamp, (8, 12), None)
    for stamp in (2, 3, 4):  # any other size is a network's own
        assert folder.of_frame("north", stamp, (8, 12), None) is not None
    assert folder.of_frame("north", 0, (12, 12), None) is not None, "a square image has no side"


def test_an_empty_map_is_none(tmp_path: Path) -> None:
    np.save(tmp_path / "north_7.npy", np.ones((0, 5), np.float32))
    with pytest.raises(ImageError, match=r"one number a pixel, this is \(0, 5\)"):
        DepthMapFolder.open("a", tmp_path).of_frame("north", 7, (8, 12), None)
