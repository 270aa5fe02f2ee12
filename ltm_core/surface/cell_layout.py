"""Memory layout of the surface map's cells: values that are read together lie together, to save cache lines.

A *place* numbers a cell as the tiles do: tile x TILE^2 + the cell in its tile, both in row-major order.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ltm_core.base.types import RecordArray, UInt8Array
from ltm_core.storage.tile_store import Field

TILE = 64
"""Cells a side of a tile."""
TILE_BITS = 6
CELLS = TILE * TILE
PLACE_BITS = 2 * TILE_BITS
NO_LABEL = 255


ESTIMATE = np.dtype(
    [("dz", "f4"), ("looks", "f4"), ("weight", "f4"), ("relative_variance", "f4"), ("pose_variance", "f4"),
     ("first", "u4"), ("last", "u4"), ("cameras", "u4"), ("base", "f4"), ("c_dz", "f4"), ("c_looks", "f4"),
     ("frames", "u2"), ("label", "u1"), ("kind", "u1")]
)  # fmt: skip
"""Fields that every observation of a cell reads: 48 bytes."""
CANDIDATE = np.dtype(
    [("c_weight", "f4"), ("c_relative_variance", "f4"), ("c_pose_variance", "f4"), ("c_first", "u4"), ("c_last", "u4"),
     ("c_cameras", "u4"), ("watched", "u4"), ("c_frames", "u2"), ("_", "u2")]
)  # fmt: skip
"""Fields that are read only by observations that contradict the estimate, and by labels."""
DECISION = np.dtype([("shift", "f4"), ("since", "u4"), ("by", "u4")])
"""Fields that no observation reads: the decision on change."""

_STORED = (
    "dz", "looks", "weight", "relative_variance", "pose_variance", "first", "last", "cameras", "frames", "label",
    "base", "c_dz", "c_looks", "c_weight", "c_relative_variance", "c_pose_variance", "c_first", "c_last", "c_cameras",
    "c_frames",
    "kind", "shift", "since", "by", "watched",
)  # fmt: skip
_BLOCK_OF = {name: i for i, block in enumerate((ESTIMATE, CANDIDATE, DECISION)) for name in block.names or ()}
FIELDS = {name: Field((ESTIMATE, CANDIDATE, DECISION)[_BLOCK_OF[name]][name]) for name in _STORED}
"""Fields of a tile in the store, in its order."""
CELL_BYTES = ESTIMATE.itemsize + CANDIDATE.itemsize + DECISION.itemsize + 1


class TileCells(NamedTuple):
    """State of the tiles in memory, (slots, cells of a tile) each.

    Of the estimate: `dz` metres above the reference; `looks`, the sum of its observations' shares of a look, and
    `weight`, that of share / variance; `relative_variance`, the mean of what they know of a shift of the whole stand,
    and `pose_variance`, that of the poses' part; `first`, `last` seen (s), `cameras` (a bit each),
    `frames`, `label` last seen. `base`: the canopy that the first consistent observations found (0 where the
    surface raster is known, NaN before). `watched`: the cameras whose labels have shown for an hour that what stood
    there stands. Of the candidate: the same, with c_. Of an accepted change: its kind, the
    smoothed `shift` from the reference and base, since when, and the cameras that agreed then.

    `high`: 1 where an estimate or a candidate may hold that something stands high enough above the reference to be
    looked for in images.
    """

    estimate: RecordArray
    candidate: RecordArray
    decision: RecordArray
    high: UInt8Array

    @classmethod
    def empty(cls, slots: int) -> TileCells:
        """Their content is arbitrary; memory is claimed as it is used."""
        estimate, candidate, decision = (np.empty((slots, CELLS), dtype) for dtype in (ESTIMATE, CANDIDATE, DECISION))
        return cls(estimate, candidate, decision, np.empty((slots, CELLS), np.uint8))

    def field(self, name: str) -> NDArray[Any]:
        """One of FIELDS, (slots, cells of a tile), a view."""
        blocks = (self.estimate, self.candidate, self.decision)
        return blocks[_BLOCK_OF[name]][name]


@njit(cache=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def place_of(row: int, col: int, across: int) -> int:
    """Of a cell of the grid, which is `across` tiles wide."""
    tile = (row >> TILE_BITS) * across + (col >> TILE_BITS)
    return (tile << PLACE_BITS) | ((row & (TILE - 1)) << TILE_BITS) | (col & (TILE - 1))
