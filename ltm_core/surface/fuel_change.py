"""Rule by which changes of the surface map change fuel cells, so that both maps agree."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.surface.change import ChangeKind
from ltm_core.surface.layers import SurfaceLayers
from ltm_core.vision.labels import Label

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
