"""The straight line that most points agree on: a network's scale and shift from points that are partly wrong.

RANSAC (Fischler and Bolles, 1981) with the median as its score (LMedS, Rousseeuw, 1984), so that the noise need not be
known beforehand, and least squares over the inliers. All trials are scored in one array operation: scikit-learn's and
scikit-image's loops take 0.1 to 1 s for what has 60 ms together with the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.depth.fusion_config import RegressionConfig
from ltm_core.types import BoolArray, Float64Array

_RULES = RegressionConfig()


@dataclass(frozen=True, eq=False)
class Line:
    """y = scale x + shift, with `sigma`, the robust standard deviation of its inliers (of weighted residuals), and
    which points are `inliers`, (N,) bool."""

    scale: float
    shift: float
    sigma: float
    inliers: BoolArray

    @property
    def inlier_ratio(self) -> float:
        return float(self.inliers.mean()) if len(self.inliers) else 0.0


def robust_line(
    x: Float64Array,
    y: Float64Array,
    weight: Float64Array | None = None,
    floor: float = 0.0,
    seed: int = 0,
    rules: RegressionConfig = _RULES,
) -> Line | None:
    """The line through the points (N,) that at most half of them contradict.

    `weight`: (N,) factors of the residuals. `floor`: the least sigma of a weighted residual that is believed, so that
    points without noise stay inliers. None where fewer than `rules.fewest` points are given or x does not vary.
    """
    weights = np.ones_like(x) if weight is None else weight
    if len(x) < rules.fewest or not np.ptp(x) > 1e-9 * max(1.0, float(np.abs(x).max())):
        return None
    rng = np.random.default_rng(seed)
    first, second = rng.integers(0, len(x), (2, rules.trials))
    run = x[second] - x[first]
    usable = np.abs(run) > rules.least_run * np.ptp(x)
    if not usable.any():
        return None
    first, second, run = first[usable], second[usable], run[usable]
    scales = (y[second] - y[first]) / run
    shifts = y[first] - scales * x[first]
    scored = slice(None, None, max(1, len(x) // rules.scored))
    # Single precision will do to tell the best trial: it is refined below.
    trial = (scales[:, None].astype(np.float32), shifts[:, None].astype(np.float32))
    points = (x[scored].astype(np.float32), y[scored].astype(np.float32), weights[scored].astype(np.float32))
    residuals = np.abs(trial[0] * points[0] + trial[1] - points[1]) * points[2]
    half = residuals.shape[1] // 2
    medians = np.partition(residuals, half, axis=1)[:, half]
    best = int(np.argmin(medians))
    scale, shift = float(scales[best]), float(shifts[best])
    for _ in range(rules.refined):
        off = np.abs(scale * x + shift - y) * weights
        sigma = max(1.4826 * float(np.median(off)), floor)
        inliers = off <= rules.band * sigma
        # Among outliers the median overstates the noise; that of the inliers does not.
        sigma = max(1.4826 * float(np.median(off[inliers])), floor)
        inliers = off <= rules.band * sigma
        if inliers.sum() < rules.fewest or not np.ptp(x[inliers]) > 0:
            break
        w = weights[inliers]
        design = np.stack([x[inliers] * w, w], axis=1)
        (scale, shift), *_ = np.linalg.lstsq(design, y[inliers] * w, rcond=None)
    off = np.abs(scale * x + shift - y) * weights
    return Line(float(scale), float(shift), sigma, off <= rules.band * sigma)


def robust_offset(values: Float64Array, floor: float = 0.0, rules: RegressionConfig = _RULES) -> Line | None:
    """The number that most of `values` (N,) lie around, as a line of scale 1: the middle of their densest half."""
    if len(values) < rules.fewest:
        return None
    ordered = np.sort(values)
    half = (len(ordered) + 1) // 2
    widths = ordered[half - 1 :] - ordered[: len(ordered) - half + 1]
    start = int(np.argmin(widths))
    shift = float(np.median(ordered[start : start + half]))
    sigma = floor
    for _ in range(rules.refined):
        off = np.abs(values - shift)
        sigma = max(1.4826 * float(np.median(off)), floor)
        inliers = off <= rules.band * sigma
        sigma = max(1.4826 * float(np.median(off[inliers])), floor)
        inliers = off <= rules.band * sigma
        shift = float(values[inliers].mean())
    return Line(1.0, shift, sigma, np.abs(values - shift) <= rules.band * sigma)
