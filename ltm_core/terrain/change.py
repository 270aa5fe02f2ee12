"""Where independent views agree that the surface is not what the reference says."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from ltm_core.site import TerrainConfig
from ltm_core.terrain.cell_kernel import Rules, independent, mean_variance
from ltm_core.terrain.reference import Reference
from ltm_core.terrain.tile_pool import TILE
from ltm_core.tile_store import Key, Tile

SMOOTHING = 1.5
"""Metres: the deviation of the Gaussian over which neighbours speak for each other."""
WIDE = 4.0
"""Metres: that over which they do where the nearer ones do not know."""
_WIDE_SIGMA = 2.0
"""Metres by which a cell may differ from the mean of that wide neighbourhood."""
_OWN_SHARE = 0.4
"""Of its neighbours' shift that a cell must show itself: a gap in a felled stand was no tree."""
_WEAKLY_SURE, _WEAKLY_CHANGED = 0.33, 0.75
"""Of the confidence and of the threshold that a cell needs beside a surely changed one."""
_COMPATIBLE = 2.0
"""Deviations by which a cell's own estimate may miss its neighbours' shift and still not contradict it."""
_BRIDGED = 2
"""Cells around each that its region reaches over."""
_REACH = 4.0
"""Deviations of the Gaussian that are taken."""

Floats = NDArray[np.float32]
Window = tuple[int, int, int, int]


class ChangeKind(IntEnum):
    """What happened to a cell."""

    NONE = 0
    REMOVED = 1
    """What stood there is gone; the ground is where it was."""
    GROWN = 2
    """Something stands, or stands higher, where it did not."""
    LOWERED = 3
    """The ground itself is lower: below bare earth."""


@dataclass(frozen=True, eq=False)
class Changed:
    """Cells whose kind of change is new, (N,) each: row, col, kind before and now, and the shift from the reference in
    metres.
    """

    rows: NDArray[np.int32]
    cols: NDArray[np.int32]
    before: NDArray[np.uint8]
    kind: NDArray[np.uint8]
    shift: Floats

    @classmethod
    def none(cls) -> Changed:
        cells, kinds = np.empty(0, np.int32), np.empty(0, np.uint8)
        return cls(cells, cells, kinds, kinds, np.empty(0, np.float32))

    def joined(self, other: Changed) -> Changed:
        return Changed(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))

    def within(self, mask: NDArray[np.bool_], window: Window) -> Changed:
        """Only the cells that lie in `mask`, whose first cell is the window's."""
        kept = mask[self.rows - window[0], self.cols - window[1]]
        return Changed(*(getattr(self, f.name)[kept] for f in fields(self)))


def margin_of(resolution: float) -> int:
    """Cells beyond a window that decide about cells inside it."""
    return math.ceil(_REACH * WIDE / resolution)


def mosaic(peek: Callable[[Key], Tile | None], window: Window, names: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Fields of the cells of a window, (h, w) each, zero where nobody has looked. The window starts on a tile's edge
    or anywhere.
    """
    row, col, height, width = window
    parts: dict[str, NDArray[Any]] = {}
    for tile_row in range(row // TILE, (row + height - 1) // TILE + 1):
        for tile_col in range(col // TILE, (col + width - 1) // TILE + 1):
            tile = peek((tile_row, tile_col))
            if tile is None:
                continue
            r, c = tile_row * TILE - row, tile_col * TILE - col
            top, left = max(-r, 0), max(-c, 0)
            bottom, right = min(height - r, TILE), min(width - c, TILE)
            for name in names:
                if name not in parts:
                    parts[name] = np.zeros((height, width), tile[name].dtype)
                parts[name][r + top : r + bottom, c + left : c + right] = tile[name][top:bottom, left:right]
    return parts


_OF_ESTIMATE = ("looks", "weight", "pose_variance", "first", "last", "cameras")
_NEEDED = ("dz", *_OF_ESTIMATE, "base", "kind", "shift", "since", "by")


def decide(
    peek: Callable[[Key], Tile | None], reference: Reference, window: Window, config: TerrainConfig, rules: Rules
) -> tuple[Changed, Mapping[str, NDArray[Any]]]:
    """The changes in a window, and its new fields base, kind, shift, since and by, (h, w) each.

    The estimates of cells that independent views have seen are smoothed with their weights. Change is where the result
    is beyond the threshold and sure enough, with the connected cells around it where it is at least half of that;
    regions smaller than `min_area` are left out.
    """
    parts = mosaic(peek, window, _NEEDED)
    row, col, height, width = window
    part = slice(row, row + height), slice(col, col + width)
    ground, surface = reference.bare[part], reference.surface[part]
    variance, sure = estimate_variance(parts, rules)
    base = parts["base"]
    if not reference.canopy_known:
        # What consistent views first found is the canopy, unless it is lower than bare earth can be.
        fresh = np.isnan(base) & sure
        base = np.where(fresh, np.where(parts["dz"] < -config.threshold, np.float32(0), parts["dz"]), base)
    usable = sure & np.isfinite(base) & np.isfinite(surface)
    off = np.where(usable, parts["dz"] - np.nan_to_num(base), np.float32(0)).astype(np.float32)
    weight = np.where(usable, 1 / (variance + rules.reference_variance), 0).astype(np.float32)
    shift, doubt = _mean_of_neighbours(off, weight, reference.geometry.resolution)
    strong, weak = _levels(off, variance, shift, doubt, usable, parts["kind"] > 0, config)
    # What never stood there cannot have been removed: such a cell is lowered, by its own account, or as it was.
    stood = surface + np.nan_to_num(base) - ground
    weak &= (shift > 0) | (stood >= config.threshold) | _shows(off, shift, config.threshold)
    kept = _regions(strong, weak, config.min_area / reference.geometry.resolution**2)
    kind = np.zeros((height, width), np.uint8)
    below = surface + np.nan_to_num(base) + shift < ground - config.threshold
    kind[kept & (shift > 0)] = ChangeKind.GROWN
    kind[kept & (shift < 0)] = np.where(below, ChangeKind.LOWERED, ChangeKind.REMOVED)[kept & (shift < 0)]
    new = kind != parts["kind"]
    begun = new & (kind > 0)
    since = np.where(begun, parts["last"], np.where(kind > 0, parts["since"], 0)).astype(np.uint32)
    by = np.where(begun, parts["cameras"], np.where(kind > 0, parts["by"], 0)).astype(np.uint32)
    shift = np.where(kind > 0, _own(off, shift, variance, usable, reference), np.float32(0)).astype(np.float32)
    rows, cols = np.nonzero(new)
    changed = Changed(
        (rows + row).astype(np.int32), (cols + col).astype(np.int32), parts["kind"][new], kind[new], shift[new]
    )
    return changed, {"base": base.astype(np.float32), "kind": kind, "shift": shift, "since": since, "by": by}


def _mean_of_neighbours(off: Floats, weight: Floats, resolution: float) -> tuple[Floats, Floats]:
    """What each cell's neighbours say of its shift, and the deviation of that. Where the near ones are unsure, as on
    the steep sides of crowns, the wider neighbourhood counts the more.
    """
    near, near_doubt = _smoothed(off, weight, SMOOTHING / resolution)
    wide, wide_doubt = _smoothed(off, weight, WIDE / resolution)
    with np.errstate(divide="ignore", invalid="ignore"):
        of_near, of_wide = 1 / near_doubt**2, 1 / (wide_doubt**2 + _WIDE_SIGMA**2)
        mean = (of_near * near + of_wide * wide) / (of_near + of_wide)
        doubt = 1 / np.sqrt(of_near + of_wide)
    known = of_near + of_wide > 0
    return np.where(known, mean, 0).astype(np.float32), np.where(known, doubt, np.inf).astype(np.float32)


def _smoothed(off: Floats, weight: Floats, sigma: float) -> tuple[Floats, Floats]:
    """The weighted mean of each cell's neighbourhood, and its deviation as if the neighbours' errors were one."""
    total = _blurred(weight, sigma)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = _blurred(weight * off, sigma) / total
        doubt = np.sqrt(_blurred((weight > 0).astype(np.float32), sigma) / total)
    known = total > 1e-6
    return np.where(known, mean, 0).astype(np.float32), np.where(known, doubt, np.inf).astype(np.float32)


def _own(off: Floats, mean: Floats, variance: Floats, usable: NDArray[np.bool_], reference: Reference) -> Floats:
    """Each cell's shift between its own estimate and its neighbours' mean: the more its own, the more neighbours differ
    among each other beyond their noise.
    """
    sigma = SMOOTHING / reference.geometry.resolution
    count = np.maximum(_blurred(usable.astype(np.float32), sigma), 1e-6)
    noise = np.where(usable, variance, 0).astype(np.float32)
    spread = _blurred(np.where(usable, (off - mean) ** 2, 0).astype(np.float32), sigma) / count
    real = np.maximum(spread - _blurred(noise, sigma) / count, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        gain = np.where(usable, real / (real + variance), 0)
    # A heavy tail is no detail.
    bounded = np.sign(mean) * np.clip(off * np.sign(mean), 0, 2 * np.abs(mean))
    return np.asarray(mean + gain * (bounded - mean), np.float32)


def _blurred(values: Floats, sigma: float) -> Floats:
    if sigma < 0.3:
        return values
    return np.asarray(ndimage.gaussian_filter(values, sigma, mode="constant", truncate=_REACH), np.float32)


def _levels(
    off: Floats,
    variance: Floats,
    shift: Floats,
    doubt: Floats,
    usable: NDArray[np.bool_],
    former: NDArray[np.bool_],
    config: TerrainConfig,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Cells that are surely changed, and those that are if they touch such. A smoothed shift that the cell's own
    estimate does not show is the neighbours'.
    """
    half = config.threshold / 2
    own = usable & _shows(off, shift, config.threshold)
    strong = own & (np.abs(shift) >= config.threshold) & (np.abs(shift) >= config.confidence * doubt)
    strong |= own & former & (np.abs(shift) >= half)
    compatible = own | (usable & ((off - shift) ** 2 <= _COMPATIBLE**2 * variance))
    sure = np.abs(shift) >= _WEAKLY_SURE * config.confidence * doubt
    weak = compatible & sure & (np.abs(shift) >= _WEAKLY_CHANGED * config.threshold)
    return strong, weak | strong


def _shows(off: Floats, shift: Floats, threshold: float) -> NDArray[np.bool_]:
    """Whether a cell's own estimate shows its neighbours' shift."""
    return np.asarray(off * np.sign(shift) >= np.maximum(threshold / 2, _OWN_SHARE * np.abs(shift)), np.bool_)


def _regions(strong: NDArray[np.bool_], weak: NDArray[np.bool_], least: float) -> NDArray[np.bool_]:
    """Cells of `weak` in regions that hold a strong cell and at least `least` cells. A region goes on across
    a few cells that nobody sees: of a wood, cameras see crowns.
    """
    near = ndimage.binary_dilation(weak, np.ones((3, 3)), iterations=_BRIDGED)
    labels, count = ndimage.label(near, np.ones((3, 3)))
    if count == 0:
        return weak
    area = np.bincount(labels[weak], minlength=count + 1)
    sure = np.bincount(labels[strong], minlength=count + 1)
    kept = (area >= least) & (sure > 0)
    kept[0] = False
    return np.asarray(kept[labels] & weak, np.bool_)


def estimate_variance(parts: Mapping[str, NDArray[Any]], rules: Rules) -> tuple[Floats, NDArray[np.bool_]]:
    """Variance of each cell's estimate, infinite where there is none, and whether independent views made it."""
    looks, weight, pose, first, last, cameras = (parts[name] for name in _OF_ESTIMATE)
    variance, sure = _summary(looks, weight, pose, first, last, cameras, rules)
    return variance, sure


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _summary(
    looks: Floats,
    weight: Floats,
    pose_variance: Floats,
    first: NDArray[np.uint32],
    last: NDArray[np.uint32],
    cameras: NDArray[np.uint32],
    rules: Rules,
) -> tuple[Floats, NDArray[np.bool_]]:
    variance = np.full(looks.shape, np.inf, np.float32)
    sure = np.zeros(looks.shape, np.bool_)
    for r in range(looks.shape[0]):
        for c in range(looks.shape[1]):
            if looks[r, c] > 0:
                variance[r, c] = mean_variance(looks[r, c], weight[r, c], pose_variance[r, c], cameras[r, c])
                sure[r, c] = independent(cameras[r, c], first[r, c], last[r, c], rules.independent_after, rules.settle)
    return variance, sure
