"""Detect surface change: cells where independent views agree that the surface differs from the reference."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.kernels import kernel
from ltm_core.base.types import BoolArray, Float32Array, Int32Array, UInt8Array, UInt32Array
from ltm_core.storage.tile_store import Key
from ltm_core.storage.tile_store_schema import Tile
from ltm_core.surface.cell_layout import TILE
from ltm_core.surface.cell_update import Rules, independent, mean_variance
from ltm_core.surface.config import TerrainConfig
from ltm_core.surface.neighbours import REACH, WIDE, Estimates, mean_of_neighbours, own_shift, regions, stand_rise
from ltm_core.surface.reference_surface import Reference

_OWN_SHARE = 0.4
"""Share of its neighbours' shift that a cell must show itself; a gap in a felled stand was no tree."""
_WEAKLY_SURE, _WEAKLY_CHANGED = 0.33, 0.75
"""Shares of the confidence and of the threshold that a cell needs next to a surely changed one."""
_COMPATIBLE = 2.0
"""Number of deviations by which a cell's own estimate may differ from its neighbours' shift without contradiction."""

Window = tuple[int, int, int, int]


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
    def none(cls) -> Changed:
        cells, kinds = np.empty(0, np.int32), np.empty(0, np.uint8)
        return cls(cells, cells, kinds, kinds, np.empty(0, np.float32))

    def joined(self, other: Changed) -> Changed:
        return Changed(*(np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)))

    def within(self, mask: BoolArray, window: Window) -> Changed:
        """Return only the cells in `mask`, whose first cell is the window's."""
        kept = mask[self.rows - window[0], self.cols - window[1]]
        return Changed(*(getattr(self, f.name)[kept] for f in fields(self)))


def margin_of(resolution: float) -> int:
    """Return the number of cells beyond a window that influence cells inside it."""
    return math.ceil(REACH * WIDE / resolution)


def mosaic(peek: Callable[[Key], Tile | None], window: Window, names: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Return fields of the cells of a window, (h, w) each, zero where unseen. The window may start anywhere."""
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


_OF_ESTIMATE = ("looks", "weight", "relative_variance", "pose_variance", "first", "last", "cameras")
_NEEDED = ("dz", *_OF_ESTIMATE, "base", "kind", "shift", "since", "by", "watched")


def decide(
    peek: Callable[[Key], Tile | None], reference: Reference, window: Window, config: TerrainConfig, rules: Rules
) -> tuple[Changed, Mapping[str, NDArray[Any]]]:
    """Return the changes in a window, and its new fields base, kind, shift, since and by, (h, w) each.

    Change is where the smoothed shift exceeds the threshold and is significant, and the connected cells around it that
    moved the same way; regions smaller than `min_area` are left out.
    """
    parts = mosaic(peek, window, _NEEDED)
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
    new = kind != parts["kind"]
    begun = new & (kind > 0)
    since = np.where(begun, parts["last"], np.where(kind > 0, parts["since"], 0)).astype(np.uint32)
    by = np.where(begun, parts["cameras"], np.where(kind > 0, parts["by"], 0)).astype(np.uint32)
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
    return changed, {"base": base.astype(np.float32), "kind": kind, "shift": shift, "since": since, "by": by}


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
    variance, relative_variance, sure = _summary(*(parts[name] for name in _OF_ESTIMATE), rules)
    return variance, relative_variance, sure


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
