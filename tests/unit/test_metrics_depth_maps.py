"""Depth maps of others: files, units, sizes, and the fit of those without a scale."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from ltm_core.errors import ConfigError, ImageError
from ltm_core.metrics.depth_fit import at_pixels_of, fit_to_truth
from ltm_core.metrics.depth_maps_io import DepthMapFolder

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


def test_files(tmp_path: Path) -> None:
    depth = np.array([[1.5, np.inf, 2.25]], np.float32)
    (tmp_path / "north").mkdir()
    np.save(tmp_path / "north/7.npy", depth[None])
    cv2.imwrite(str(tmp_path / "east_8.tif"), depth)
    folder = DepthMapFolder.open("unidepth", tmp_path)
    np.testing.assert_array_equal(folder.read("north", 7), depth)
    np.testing.assert_array_equal(folder.read("east", 8), depth)
    assert folder.read("east", 7) is None
    np.save(tmp_path / "east_9.npy", np.zeros((2, 3, 3)))
    with pytest.raises(ImageError, match="one number a pixel"):
        folder.read("east", 9)
    (tmp_path / "east_10.npy").write_bytes(b"none")
    with pytest.raises(ImageError, match="no depth map"):
        folder.read("east", 10)


def test_integers_need_a_unit(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "north_7.png"), np.array([[0, 12, 65535]], np.uint16))
    with pytest.raises(ImageError, match=r"metres_per_unit.*depth_maps.yaml"):
        DepthMapFolder.open("a", tmp_path).read("north", 7)
    (tmp_path / "depth_maps.yaml").write_text("metres_per_unit: 0.5\nkind: affine_invariant\n")
    folder = DepthMapFolder.open("a", tmp_path)
    assert folder.config.kind == "affine_invariant"
    np.testing.assert_array_equal(folder.read("north", 7), [[np.nan, 6, 32767.5]])
    (tmp_path / "depth_maps.yaml").write_text("metres: 1\n")
    with pytest.raises(ConfigError, match="unknown key"):
        DepthMapFolder.open("a", tmp_path)
    (tmp_path / "none").mkdir()
    with pytest.raises(ImageError, match="holds no depth map"):
        DepthMapFolder.open("a", tmp_path / "none")
