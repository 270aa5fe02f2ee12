from pathlib import Path

import numpy as np
import pytest

from ltm_core.base.errors import ImageError
from ltm_core.scoring.labels import at_pixels_of
from ltm_lab.evaluation.depth.depth_maps_io import read_depth_map
from ltm_lab.evaluation.depth.fused_depth import fit_to_truth

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
    metres = fit_to_truth(TRUTH / 7, TRUTH, "metric")
    np.testing.assert_allclose(metres[known], TRUTH[known], rtol=1e-6)
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
    with pytest.raises(ImageError, match=r"\(4, 5\)"):
        at_pixels_of(depth, (10, 18), (4, 5))


def test_files(tmp_path: Path) -> None:
    depth = np.array([[1.5, np.inf, 2.25]], np.float32)
    (tmp_path / "north").mkdir()
    np.save(tmp_path / "north/7.npy", depth[None])
    np.testing.assert_array_equal(read_depth_map(tmp_path, "north", 7, (1, 3)), depth)
    with pytest.raises(ImageError, match=r"has no depth map north/8\.npy"):
        read_depth_map(tmp_path, "north", 8, (1, 3))
    for values, said in (
        (np.zeros((2, 3, 3)), "one number"),
        (np.ones((0, 5)), "one number"),
        (np.ones((1, 3), int), "float"),
    ):
        np.save(tmp_path / "north/9.npy", values)
        with pytest.raises(ImageError, match=said):
            read_depth_map(tmp_path, "north", 9, (1, 3))
    (tmp_path / "north/10.npy").write_bytes(b"none")
    with pytest.raises(ImageError, match=r"10\.npy is damaged"):
        read_depth_map(tmp_path, "north", 10, (1, 3))
