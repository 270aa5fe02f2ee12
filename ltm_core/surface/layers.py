"""Make the layers of a surface map as rasters, and what its changes mean for the fuel map."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array, UInt32Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.surface.cell_update import Rules
from ltm_core.surface.change import ChangeKind, Window, estimate_variance, mosaic
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.tile_pool import TilePool
from ltm_core.vision.labels import Label

_FIELDS = (
    "dz", "looks", "weight", "relative_variance", "pose_variance", "first", "last", "cameras", "frames", "label",
    "base", "kind", "shift", "since", "by",
)  # fmt: skip
_NO_LABEL = 255
_NOT_LOOKED = 255


@dataclass(frozen=True, eq=False)
class SurfaceLayers:
    """Rasters (H, W) of a window of the grid, in the map frame.

    `bare`, `reference`: metres, as they were given. `height`: the updated surface: the reference (with the canopy that
    the first views found, where no surface raster was given), moved where change was accepted. `estimate`: what the
    cameras measured, NaN where independent views have not agreed. `sigma`: of that estimate, NaN in unseen
    cells. `change`: ChangeKind. `observed`: seen by independent views. `frames`: how many saw the cell. `cameras`:
    how many. `last_seen`: s, 0 never. `since`: s, when an accepted change had been seen, else 0. `by`: the mask of the
    cameras that agreed on it. `label`: class last seen, 255 none."""

    geometry: GridGeometry
    bare: Float32Array
    reference: Float32Array
    height: Float32Array
    estimate: Float32Array
    sigma: Float32Array
    change: UInt8Array
    observed: BoolArray
    frames: NDArray[np.uint16]
    cameras: UInt8Array
    last_seen: UInt32Array
    since: UInt32Array
    by: UInt32Array
    label: UInt8Array

    @property
    def told(self) -> UInt8Array:
        """Return (H, W) ChangeKind for publication: 255 where independent views have not seen the cell."""
        known = self.observed | (self.change > 0)
        return np.where(known, self.change, np.uint8(_NOT_LOOKED)).astype(np.uint8)


def layers_of(pool: TilePool, reference: Reference, window: Window | None, rules: Rules) -> SurfaceLayers:
    """Return the layers of a window (row, col, height, width); None: the whole grid."""
    height, width = reference.geometry.shape
    window = window or (0, 0, height, width)
    shape = window[2:]
    parts = mosaic(pool.peek, window, _FIELDS)
    part = slice(window[0], window[0] + shape[0]), slice(window[1], window[1] + shape[1])
    bare, surface = reference.bare[part], reference.surface[part]
    if not parts:
        unknown = np.full(shape, np.nan, np.float32)
        seconds = np.zeros(shape, np.uint32)
        return SurfaceLayers(
            reference.geometry.window(*window), bare, surface, surface.copy(), unknown, unknown.copy(),
            np.zeros(shape, np.uint8), np.zeros(shape, np.bool_), np.zeros(shape, np.uint16), np.zeros(shape, np.uint8),
            seconds, seconds.copy(), seconds.copy(), np.full(shape, _NO_LABEL, np.uint8),
        )  # fmt: skip
    variance, _, sure = estimate_variance(parts, rules)
    base = np.nan_to_num(parts["base"])
    seen = parts["looks"] > 0
    return SurfaceLayers(
        reference.geometry.window(*window),
        bare,
        surface,
        (surface + base + parts["shift"]).astype(np.float32),
        np.where(sure, surface + parts["dz"], np.float32(np.nan)).astype(np.float32),
        np.where(seen, np.sqrt(variance), np.float32(np.nan)).astype(np.float32),
        parts["kind"],
        sure,
        parts["frames"],
        _bit_counts(parts["cameras"]),
        parts["last"],
        parts["since"],
        parts["by"],
        np.where(parts["frames"] > 0, parts["label"], np.uint8(_NO_LABEL)).astype(np.uint8),
    )


def _bit_counts(masks: UInt32Array) -> UInt8Array:
    bits = np.unpackbits(np.ascontiguousarray(masks).view(np.uint8).reshape(*masks.shape, 4), axis=-1)
    return np.asarray(bits.sum(axis=-1), np.uint8)


LEAST_SHARE = 0.25
"""Minimum share of the seen part of a fuel cell that must have changed in one way."""
LEAST_SEEN = 0.1
"""Minimum share of a fuel cell that independent views must have seen."""
SHRUB_BELOW = 3.0
"""Height in metres below which new growth is shrub if no label contradicts."""


class FuelChange(StrEnum):
    """Kind of change that a fuel cell takes over from the surface map."""

    REMOVED = "removed"
    GROWN = "grown"
    MOVED_GROUND = "moved ground"


_OF = {
    ChangeKind.REMOVED: FuelChange.REMOVED,
    ChangeKind.GROWN: FuelChange.GROWN,
    ChangeKind.LOWERED: FuelChange.MOVED_GROUND,
}


@dataclass(frozen=True)
class FuelCellChange:
    """Change of one fuel cell: its row and col, the kind, the share of its seen part that shows it, the median shift of
    that part in metres, the life form now (a class id of the label set, None: unknown), the time when the change was
    first seen (s), and the mask of the cameras that agreed."""

    row: int
    col: int
    change: FuelChange
    share: float
    shift: float
    cover: int | None
    since: int
    cameras: int


def fuel_changes(layers: SurfaceLayers, fuel: GridGeometry) -> list[FuelCellChange]:
    """Return the cells of the fuel grid (in the map frame) that the surface's changes concern, in row-major order."""
    rows, cols = np.nonzero(layers.observed | (layers.change > 0))
    if len(rows) == 0:
        return []
    x, y = layers.geometry.to_map(rows, cols)
    fuel_row, fuel_col = fuel.cell_of(x, y)
    inside = fuel.contains(fuel_row, fuel_col)
    rows, cols, cell = rows[inside], cols[inside], (fuel_row * fuel.width + fuel_col)[inside]
    order = np.argsort(cell, kind="stable")
    rows, cols, cell = rows[order], cols[order], cell[order]
    whole = (fuel.resolution / layers.geometry.resolution) ** 2
    found = []
    starts = np.flatnonzero(np.r_[True, np.diff(cell) > 0])
    for start, end in zip(starts, np.r_[starts[1:], len(cell)], strict=True):
        part = rows[start:end], cols[start:end]
        kinds = layers.change[part]
        if end - start < LEAST_SEEN * whole or not kinds.any():
            continue
        counts = np.bincount(kinds, minlength=len(ChangeKind))
        kind = ChangeKind(int(np.argmax(counts[1:])) + 1)
        share = float(counts[kind]) / float(end - start)
        if share < LEAST_SHARE:
            continue
        of_kind = kinds == kind
        shift = float(np.median((layers.height[part] - layers.reference[part])[of_kind]))
        found.append(
            FuelCellChange(
                int(cell[start] // fuel.width),
                int(cell[start] % fuel.width),
                _OF[kind],
                share,
                shift,
                cover_after(kind, shift, layers.label[part][of_kind]),
                int(layers.since[part][of_kind].min()),
                int(np.bitwise_or.reduce(layers.by[part][of_kind])),
            )
        )
    return found


def cover_after(kind: ChangeKind, shift: float, labels: UInt8Array) -> int | None:
    """Return the cover of a surface that has moved by `shift` metres with these labels; None: unknown. Moved ground is
    bare; what has grown is neither bare nor grass; what was removed is not what a label of what stood there says."""
    if kind == ChangeKind.LOWERED:
        return int(Label.BARE)
    known = labels[labels != 255]
    voted = int(np.bincount(known).argmax()) if len(known) else None
    if kind == ChangeKind.REMOVED:
        return voted if voted in (Label.GRASS, Label.SHRUB, Label.BARE, Label.BUILT) else None
    if voted in (Label.SHRUB, Label.TREE, Label.BUILT):
        return voted
    return int(Label.SHRUB) if shift < SHRUB_BELOW else int(Label.TREE)
