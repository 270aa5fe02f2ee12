"""Errors of surface heights against truth, and resampling of one raster to the coarser grid of another."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import RasterError
from ltm_core.base.types import BoolArray, Float32Array
from ltm_core.geometry.grid import GridGeometry


@dataclass(frozen=True)
class SurfaceScore:
    """Errors of heights, metres; NaN without a cell."""

    cells: int
    rmse: float
    mae: float
    median: float
    """Median absolute error."""
    bias: float
    """Mean of estimate minus truth."""


def score_surface(
    estimate: NDArray[np.floating[Any]], truth: NDArray[np.floating[Any]], where: BoolArray | None = None
) -> SurfaceScore:
    """Score heights of one shape where both are finite (and `where` holds). Raises RasterError on other shapes."""
    if estimate.shape != truth.shape or (where is not None and where.shape != truth.shape):
        raise RasterError(f"heights of {estimate.shape} cannot be scored against truth of {truth.shape}")
    both = np.isfinite(estimate) & np.isfinite(truth)
    if where is not None:
        both &= where
    error = estimate[both].astype(np.float64) - truth[both]
    if error.size == 0:
        return SurfaceScore(0, np.nan, np.nan, np.nan, np.nan)
    size = np.abs(error)
    rmse = float(np.sqrt(np.mean(error**2)))
    return SurfaceScore(error.size, rmse, float(size.mean()), float(np.median(size)), float(error.mean()))


def cell_means(values: Float32Array, geometry: GridGeometry, onto: GridGeometry) -> Float32Array:
    """Means of a raster over the cells of another that is as coarse or coarser, (H, W); NaN where none is known.

    Both in one frame. A cell is the mean of the raster at n x n places spread evenly in it, n so that no cell of the
    raster is left out. Raises RasterError where the raster is coarser than the cells."""
    ratio = onto.resolution / geometry.resolution
    if ratio < 1 - 1e-6:
        raise RasterError(f"a raster of {geometry.resolution} m gives no means over cells of {onto.resolution} m")
    n = int(np.ceil(ratio - 1e-6))
    offsets = (np.arange(n) + 0.5) / n - 0.5
    total = np.zeros(onto.shape)
    count = np.zeros(onto.shape, np.int32)
    for down in offsets:
        for right in offsets:
            _, y = onto.to_map(np.arange(onto.height) + down, 0)
            x, _ = onto.to_map(0, np.arange(onto.width) + right)
            row, col = geometry.cell_of(x[None, :], y[:, None])
            row, col = np.broadcast_arrays(row, col)
            inside = geometry.contains(row, col)
            picked = np.where(inside, values[np.where(inside, row, 0), np.where(inside, col, 0)], np.nan)
            known = np.isfinite(picked)
            total += np.where(known, picked, 0)
            count += known
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)
