"""Depth scores computed plainly, all pixels in memory at once: what the tally of `ltm-lab eval` is held against."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.scoring.labels import RANGE_BINS, DepthScore


def score_depth(estimate: Sequence[Float32Array], truth: Sequence[Float32Array]) -> list[DepthScore]:
    """Scores by range bin, then over all, of images in pairs of one shape.

    Pixels count where both are finite. Raises ImageError on a pair of different shapes.
    """
    for a, b in zip(estimate, truth, strict=True):
        if a.shape != b.shape:
            raise ImageError(f"depth of {a.shape} cannot be scored against truth of {b.shape}")
    depth = np.concatenate([a.ravel() for a in estimate]) if estimate else np.empty(0, np.float32)
    true = np.concatenate([b.ravel() for b in truth]) if truth else np.empty(0, np.float32)
    both = np.isfinite(depth) & np.isfinite(true)
    error, true = depth[both].astype(np.float64) - true[both], true[both]
    bins = [*pairwise(RANGE_BINS), (0.0, np.inf)]
    return [_score(error[(true >= near) & (true < far)], near, far) for near, far in bins]


def _score(error: Float64Array, near: float, far: float) -> DepthScore:
    if len(error) == 0:
        return DepthScore(near, far, 0, np.nan, np.nan, np.nan, np.nan)
    size = np.abs(error)
    rmse = float(np.sqrt(np.mean(error**2)))
    return DepthScore(near, far, len(error), rmse, float(size.mean()), float(np.median(size)), float(error.mean()))
