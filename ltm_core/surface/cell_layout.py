"""Memory layout of the cells of a surface map, and of the sums of one frame's observations.

A *place* numbers a cell as the tiles do: tile x TILE^2 + the cell in its tile, both in row-major order."""

import math
from typing import NamedTuple

import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Int32Array, Int64Array, RecordArray, UInt8Array
from ltm_core.storage.tile_store_schema import Field

TILE = 64
"""Number of cells per side of a tile."""
TILE_BITS = 6
CELLS = TILE * TILE
PLACE_BITS = 2 * TILE_BITS

CELL = np.dtype(
    [("dz", "f4"), ("looks", "f4"), ("weight", "f4"), ("relative_variance", "f4"), ("pose_variance", "f4"),
     ("first", "u4"), ("last", "u4"), ("cameras", "u4"), ("frames", "u2"), ("base", "f4"), ("c_dz", "f4"),
     ("c_looks", "f4"), ("c_weight", "f4"), ("c_relative_variance", "f4"), ("c_pose_variance", "f4"),
     ("c_first", "u4"), ("c_last", "u4"), ("c_cameras", "u4"), ("c_frames", "u2"), ("kind", "u1"), ("shift", "f4"),
     ("since", "u4"), ("watched", "u4")],
    align=True,
)  # fmt: skip
"""State of a cell.

Of the estimate: `dz` metres above the reference; `looks`, the sum of its observations' shares of a look, and `weight`,
that of share / variance; `relative_variance`, the mean of that of a shift of the whole stand, and `pose_variance`;
`first`, `last` seen (s), `cameras` (a bit each), `frames`. `base`: the canopy that the first observations found (0 with
a surface raster, NaN before). Of the candidate: the same, with c_. Of an accepted change: `kind`, smoothed `shift`,
`since`. `watched`: the cameras whose labels have shown for an hour that something stands."""
FIELDS = {name: Field(CELL[name]) for name in CELL.names or ()}
"""Fields of a tile in the store, in its order."""


class TileCells(NamedTuple):
    """State of the tiles in memory, (slots, cells of a tile) each: `records` of CELL; `high`, 1 if an estimate or a
    candidate may be high enough above the reference to be looked for in images."""

    records: RecordArray
    high: UInt8Array

    @classmethod
    def empty(cls, slots: int) -> "TileCells":
        """Return cells with arbitrary content; memory is allocated on use."""
        return cls(np.empty((slots, CELLS), CELL), np.empty((slots, CELLS), np.uint8))


@helper(inline="always")
def place_of(row: int, col: int, across: int) -> int:
    """Return the place of a cell of the grid, which is `across` tiles wide."""
    tile = (row >> TILE_BITS) * across + (col >> TILE_BITS)
    return (tile << PLACE_BITS) | ((row & (TILE - 1)) << TILE_BITS) | (col & (TILE - 1))


SUM = np.dtype(
    [("place", "i4"), ("number", "f4"), ("weight", "f4"), ("moment", "f4"), ("relative_variance", "f4"), ("pose", "f4"),
     ("off_count", "f4"), ("off_weight", "f4"), ("off_moment", "f4"), ("off_pose", "f4"), ("lowest", "f4"),
     ("passed", "f4"), ("stood", "f4"), ("labelled", "f4"), ("gone", "f4"), ("stays", "f4"), ("labelled_pose", "f4")]
)  # fmt: skip
"""Sums of one cell: over pixels that agree with the reference and over those that do not (off_); the least height above
the reference at which a ray passed it (infinite: none) and by how many sigmas of range; and, of pixels that count by
their labels, their number (`labelled`), the height of what stood there, and the sums of log odds that it is gone and
that it stays."""


class FrameSums(NamedTuple):
    """`used`: number of cells and tiles in use. `cells`: their sums. `tiles`: the tiles by their number in this frame,
    `number_of` the inverse, -1 if unseen. `at`: by number of the tile and cell in it, 1 + the index of its sums, 0 if
    unseen."""

    used: Int64Array
    cells: RecordArray
    tiles: Int32Array
    number_of: Int32Array
    at: Int32Array

    @classmethod
    def empty(cls, most: int, tiles: int) -> "FrameSums":
        """Return sums for at most `most` cells of a grid of `tiles` tiles; memory is allocated on use."""
        numbers, at = np.full(tiles, -1, np.int32), np.zeros((tiles, CELLS), np.int32)
        return cls(np.zeros(2, np.int64), np.empty(most, SUM), np.empty(tiles, np.int32), numbers, at)

    @property
    def seen_tiles(self) -> Int32Array:
        """Return the tiles that the frame touches, in row-major order."""
        return np.sort(self.tiles[: self.used[1]])


@kernel()
def clear(sums: FrameSums) -> None:
    """Forget the last frame."""
    for i in range(sums.used[0]):
        place = sums.cells[i].place
        sums.at[sums.number_of[place >> PLACE_BITS], place & (CELLS - 1)] = 0
    for i in range(sums.used[1]):
        sums.number_of[sums.tiles[i]] = -1
    sums.used[:] = 0


@helper(inline="always")
def sum_of(sums: FrameSums, place: int) -> int:
    """Return the place of the sums of a cell, cleared if it is new; -1 if there is no room."""
    tile, k = place >> PLACE_BITS, place & (CELLS - 1)
    number = sums.number_of[tile]
    if number < 0:
        number = sums.used[1]
        sums.used[1] += 1
        sums.number_of[tile] = number
        sums.tiles[number] = tile
    found = sums.at[number, k]
    if found == 0:
        if sums.used[0] >= len(sums.cells):
            return -1
        one = sums.cells[sums.used[0]]
        sums.used[0] += 1
        found = sums.used[0]
        sums.at[number, k] = found
        one.place = place
        one.number = one.weight = one.moment = one.relative_variance = one.pose = 0.0
        one.off_count = one.off_weight = one.off_moment = one.off_pose = 0.0
        one.lowest = math.inf
        one.stood = one.labelled = one.gone = one.stays = one.labelled_pose = 0.0
    return int(found) - 1
