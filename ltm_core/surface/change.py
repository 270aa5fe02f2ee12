"""Detect surface change: cells where independent views and neighbours agree that the surface has changed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.base.kernels import kernel
from ltm_core.base.types import BoolArray, Float32Array, Int32Array, UInt8Array, UInt32Array
from ltm_core.surface.cell_update import Rules, independent, mean_variance
from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.tile_pool import TilePool, Window

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


_OWN_SHARE = 0.4
"""Share of its neighbours' shift that a cell must show itself; a gap in a felled stand was no tree."""
_WEAKLY_SURE, _WEAKLY_CHANGED = 0.33, 0.75
"""Shares of the confidence and of the threshold that a cell needs next to a surely changed one."""
_COMPATIBLE = 2.0
"""Number of deviations by which a cell's own estimate may differ from its neighbours' shift without contradiction."""


class ChangeKind(IntEnum):
    """Kind of change of a cell."""

    NONE = 0
    REMOVED = 1
    """An object is gone; the ground is unchanged."""
    GROWN = 2
    """Something stands, or is higher, where it was not."""
    LOWERED = 3
    """The ground itself is lower: below bare earth."""


@dataclass(frozen=True, eq=False)
class Changed:
    """Cells with a new kind of change, (N,) each: row, col, kind before and now, and the shift from the reference in
    metres."""

    rows: Int32Array
    cols: Int32Array
    before: UInt8Array
    kind: UInt8Array
    shift: Float32Array

    @classmethod
    def none(cls) -> "Changed":
        cells, kinds = np.empty(0, np.int32), np.empty(0, np.uint8)
        return cls(cells, cells, kinds, kinds, np.empty(0, np.float32))

    def joined(self, other: "Changed") -> "Changed":
        return Changed(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))


def margin_of(resolution: float) -> int:
    """Return the number of cells beyond a window that influence cells inside it."""
    return math.ceil(REACH * WIDE / resolution)


_OF_ESTIMATE = ("looks", "weight", "relative_variance", "pose_variance", "first", "last", "cameras")
_NEEDED = ("dz", *_OF_ESTIMATE, "base", "kind", "shift", "since", "watched")


def decide(
    pool: TilePool, reference: Reference, window: Window, core: BoolArray, config: TerrainConfig, rules: Rules
) -> tuple[Changed, Mapping[str, NDArray[Any]]]:
    """Return the changes in the `core` of a window, (h, w) bool, and the window's new fields base, kind, shift and
    since, (h, w) each.

    Change is where the smoothed shift exceeds the threshold and is significant, and the connected cells around it that
    moved the same way; regions smaller than `min_area` are left out."""
    parts = pool.mosaic(window, _NEEDED)
    row, col, height, width = window
    part = slice(row, row + height), slice(col, col + width)
    ground, surface = reference.bare[part], reference.surface[part]
    variance, relative_variance, sure = estimate_variance(parts, rules)
    base = parts["base"]
    if not reference.canopy_known:
        # What consistent views first found is the canopy, unless it is lower than bare earth can be.
        fresh = np.isnan(base) & sure
        base = np.where(fresh, np.where(parts["dz"] < -config.threshold, np.float32(0), parts["dz"]), base)
    usable = sure & np.isfinite(base) & np.isfinite(surface)
    known = np.nan_to_num(base)
    off = np.where(usable, parts["dz"] - known, np.float32(0)).astype(np.float32)
    # Where it is less sure that a cell has changed than how high it is then, that is what its neighbours get of it.
    weight, relative_weight = (
        np.where(usable, 1 / (one + rules.reference_variance), 0).astype(np.float32)
        for one in (np.maximum(variance, relative_variance), relative_variance)
    )
    cells = Estimates(off, weight, relative_weight, usable)
    stood = surface + known - ground
    standing = stood >= config.threshold
    shift, doubt = mean_of_neighbours(cells, standing, reference.geometry.resolution)
    # A camera that has watched what stood may tell alone that it is gone.
    watched = ((parts["cameras"] & ~parts["watched"]) == 0) & (shift < 0)
    alone = ((parts["cameras"] & (parts["cameras"] - 1)) == 0) & ~watched
    strong, weak = _levels(off, variance, shift, doubt, usable, parts["kind"] > 0, alone, config)
    # What never stood there cannot have been removed: such a cell is lowered, by its own account, or as it was.
    weak &= (shift > 0) | standing | _shows(off, shift, config.threshold)
    least, unseen = config.min_area / reference.geometry.resolution**2, standing & ~usable
    kept = np.zeros((height, width), np.bool_)
    for side in (shift > 0, shift < 0):
        kept |= regions(strong & side, weak & side, unseen, least)
    kind = np.zeros((height, width), np.uint8)
    below = stood + shift < -config.threshold
    kind[kept & (shift > 0)] = ChangeKind.GROWN
    kind[kept & (shift < 0)] = np.where(below, ChangeKind.LOWERED, ChangeKind.REMOVED)[kept & (shift < 0)]
    new = core & (kind != parts["kind"])
    begun = new & (kind > 0)
    since = np.where(begun, parts["last"], np.where(kind > 0, parts["since"], 0)).astype(np.uint32)
    own = own_shift(cells, variance, shift, reference.geometry.resolution)
    stands = standing & (kind == ChangeKind.GROWN)
    if stands.any():
        with np.errstate(divide="ignore", invalid="ignore"):
            level = np.where(usable, np.clip(parts["relative_variance"] * parts["weight"] / parts["looks"], 0, 1), 0)
        own = np.where(stands, stand_rise(off, level, stands & usable, own, reference.geometry.resolution), own)
    shift = np.where(kind > 0, own, np.float32(0)).astype(np.float32)
    rows, cols = np.nonzero(new)
    changed = Changed(
        (rows + row).astype(np.int32), (cols + col).astype(np.int32), parts["kind"][new], kind[new], shift[new]
    )
    return changed, {"base": base.astype(np.float32), "kind": kind, "shift": shift, "since": since}


def _levels(
    off: Float32Array,
    variance: Float32Array,
    shift: Float32Array,
    doubt: Float32Array,
    usable: BoolArray,
    former: BoolArray,
    alone: BoolArray,
    config: TerrainConfig,
) -> tuple[BoolArray, BoolArray]:
    """Return the cells that are surely changed, and those that are if they touch such. A smoothed shift that the cell's
    own estimate does not show is the neighbours'."""
    half = config.threshold / 2
    own = usable & _shows(off, shift, config.threshold)
    confidence = np.where(alone, np.float32(config.alone), np.float32(config.confidence))
    strong = own & (np.abs(shift) >= config.threshold) & (np.abs(shift) >= confidence * doubt)
    strong |= own & former & (np.abs(shift) >= half)
    compatible = own | (usable & ((off - shift) ** 2 <= _COMPATIBLE**2 * variance))
    sure = np.abs(shift) >= _WEAKLY_SURE * config.confidence * doubt
    weak = compatible & sure & (np.abs(shift) >= _WEAKLY_CHANGED * config.threshold)
    return strong, weak | strong


def _shows(off: Float32Array, shift: Float32Array, threshold: float) -> BoolArray:
    """Return whether a cell's own estimate shows its neighbours' shift."""
    return np.asarray(off * np.sign(shift) >= np.maximum(threshold / 2, _OWN_SHARE * np.abs(shift)), np.bool_)


def estimate_variance(parts: Mapping[str, NDArray[Any]], rules: Rules) -> tuple[Float32Array, Float32Array, BoolArray]:
    """Return the variance of each cell's estimate, its relative variance (as evidence on the stand about the cell; both
    infinite without an estimate), and whether independent views made it."""
    summary: tuple[Float32Array, Float32Array, BoolArray] = _summary(*(parts[name] for name in _OF_ESTIMATE), rules)
    return summary


@kernel()
def _summary(
    looks: Float32Array,
    weight: Float32Array,
    relative_variance: Float32Array,
    pose_variance: Float32Array,
    first: UInt32Array,
    last: UInt32Array,
    cameras: UInt32Array,
    rules: Rules,
) -> tuple[Float32Array, Float32Array, BoolArray]:
    variance = np.full(looks.shape, np.inf, np.float32)
    relative = np.full(looks.shape, np.inf, np.float32)
    sure = np.zeros(looks.shape, np.bool_)
    for r in range(looks.shape[0]):
        for c in range(looks.shape[1]):
            n, pose, mask = looks[r, c], pose_variance[r, c], cameras[r, c]
            if n > 0:
                variance[r, c] = mean_variance(n, weight[r, c], pose, mask, rules.repeated_error_share)
                relative[r, c] = mean_variance(n, n / relative_variance[r, c], pose, mask, rules.repeated_error_share)
                sure[r, c] = independent(mask, first[r, c], last[r, c], rules.independent_after, rules.settle)
    return variance, relative, sure
