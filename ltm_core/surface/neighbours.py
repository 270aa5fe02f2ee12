"""Combine each cell's height shift with its neighbours of the same kind, and group changed cells into regions.

Standing vegetation and open ground are averaged separately, because a stand grows or is felled as a whole.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array

SMOOTHING = 1.5
"""Deviation in metres of the Gaussian over which neighbours are averaged."""
WIDE = 5.0
"""Deviation in metres of the wider Gaussian that is used where near neighbours are unknown."""
REACH = 4.0
"""Number of deviations at which the Gaussians are cut off."""
_WIDE_SIGMA = 2.0
"""Metres by which a cell may differ from the mean of the wider neighbourhood."""
_BRIDGED = 2
"""Number of cells around each that its region bridges."""
_THROUGH = 8
"""Number of unseen cells of a stand that a region crosses; of a wood, cameras see only crowns."""


class Estimates(NamedTuple):
    """Estimates of cells (H, W): shift from the reference in metres; weight, 1 / variance, as a height of that cell;
    relative_weight, as a shift of the stand about it. All 0 where `usable` is False."""

    off: Float32Array
    weight: Float32Array
    relative_weight: Float32Array
    usable: BoolArray


def mean_of_neighbours(cells: Estimates, standing: BoolArray, resolution: float) -> tuple[Float32Array, Float32Array]:
    """Return the mean shift of each cell's neighbours of its own kind, `standing` or not, and its deviation if nothing
    has changed; 0 and infinite without neighbours."""
    if not (standing & cells.usable).any() or standing.all():
        return _mean(cells, cells.usable, resolution)
    upper, lower = (_mean(cells, cells.usable & kind, resolution) for kind in (standing, ~standing))
    return np.where(standing, upper[0], lower[0]), np.where(standing, upper[1], lower[1])


def _mean(cells: Estimates, kind: BoolArray, resolution: float) -> tuple[Float32Array, Float32Array]:
    """Return the nearer neighbours and the wider ones by what they know of the cell's height: where the near ones are
    unsure, as on the steep sides of crowns, the wide ones count the more."""
    near, near_variance, near_doubt = _smoothed(cells, kind, SMOOTHING / resolution)
    wide, _, wide_doubt = _smoothed(cells, kind, WIDE / resolution)
    with np.errstate(divide="ignore", invalid="ignore"):
        of_near, of_wide = 1 / near_variance, 1 / (wide_doubt**2 + np.float32(_WIDE_SIGMA**2))
        total = of_near + of_wide
        mean = (of_near * near + of_wide * wide) / total
        doubt = (np.where(of_near > 0, of_near * near_doubt, 0) + of_wide * wide_doubt) / total
    known = of_wide > 0
    return np.where(known, mean, 0).astype(np.float32), np.where(known, doubt, np.inf).astype(np.float32)


def _smoothed(cells: Estimates, kind: BoolArray, sigma: float) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Return the weighted mean of each cell's neighbourhood, its variance, and its deviation as a whole: both as if the
    neighbours' errors were one."""
    part = kind.astype(np.float32)
    weight = cells.weight * part
    count, total = blurred(part, sigma), blurred(weight, sigma)
    known = total > 1e-6
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(known, blurred(weight * cells.off, sigma) / total, np.float32(0))
        variance = np.where(known, count / total, np.float32(np.inf))
        doubt = np.where(known, np.sqrt(count / blurred(cells.relative_weight * part, sigma)), np.float32(np.inf))
    return mean, variance, doubt


def own_shift(cells: Estimates, variance: Float32Array, mean: Float32Array, resolution: float) -> Float32Array:
    """Return each cell's shift between its own estimate and its neighbours' mean; its own has more weight if neighbours
    differ by more than their noise."""
    sigma = SMOOTHING / resolution
    count = np.maximum(blurred(cells.usable.astype(np.float32), sigma), 1e-6)
    noise = np.where(cells.usable, variance, 0).astype(np.float32)
    spread = blurred(np.where(cells.usable, (cells.off - mean) ** 2, 0).astype(np.float32), sigma) / count
    real = np.maximum(spread - blurred(noise, sigma) / count, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        gain = np.where(cells.usable, real / (real + variance), 0)
    # A heavy tail is no detail.
    bounded = np.sign(mean) * np.clip(cells.off * np.sign(mean), 0, 2 * np.abs(mean))
    return np.asarray(mean + gain * (bounded - mean), np.float32)


def stand_rise(
    off: Float32Array, level: Float32Array, grown: BoolArray, shift: Float32Array, resolution: float
) -> Float32Array:
    """Return the growth of stands: the mean of their level cells over WIDE; `shift` if none is near. The face of a
    growing crown comes nearer by a fraction of its growth, so cells count by the square of `level` (0, 1]: the variance
    on the block's slope as a share of that on their own."""
    weight = np.where(grown, level**2, 0).astype(np.float32)
    sigma = WIDE / resolution
    total = blurred(weight, sigma)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(total > 1e-6, blurred(weight * off, sigma) / total, shift).astype(np.float32)


def blurred(values: Float32Array, sigma: float) -> Float32Array:
    """Blur by a Gaussian of `sigma` cells; outside values are 0."""
    if sigma < 0.3:
        return values
    side = 2 * int(REACH * sigma + 0.5) + 1
    smooth = cv2.GaussianBlur(values, (side, side), sigma, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(smooth, np.float32)


def regions(strong: BoolArray, weak: BoolArray, unseen: BoolArray, least: float) -> BoolArray:
    """Return cells of `weak` in regions with a strong cell and at least `least` cells. A region continues across a few
    cells, and through those of an unseen stand."""
    bridge = np.ones((2 * _BRIDGED + 1, 2 * _BRIDGED + 1), np.uint8)
    reached = weak.astype(np.uint8)
    open_to = (weak | unseen).astype(np.uint8)
    for _ in range(_THROUGH):
        reached = cv2.dilate(reached, np.ones((3, 3), np.uint8)) & open_to
    near = cv2.dilate(weak.astype(np.uint8), bridge) | reached
    count, labels = cv2.connectedComponents(near, connectivity=8)
    area = np.bincount(labels[weak], minlength=count)
    sure = np.bincount(labels[strong & weak], minlength=count)
    kept = (area >= least) & (sure > 0)
    kept[0] = False
    return np.asarray(kept[labels] & weak, np.bool_)
