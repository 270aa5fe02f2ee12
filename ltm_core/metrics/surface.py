"""Heights against true ones, and rasters of different grids brought together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.errors import RasterError


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
    estimate: NDArray[np.floating[Any]], truth: NDArray[np.floating[Any]], where: NDArray[np.bool_] | None = None
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
