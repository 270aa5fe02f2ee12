"""Sum one frame's observations of depth and labels over the pixels of each cell.

Uses each label of an image as evidence whether vegetation of the reference still stands; compiled.

Where something stands in the reference, a pixel's label is evidence on the cell that it would see: that the cell is as
high as it was, or as low as bare earth. Whatever is surely seen in front of it hides it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from ltm_core.base.types import Float32Array, Int32Array, Int64Array, RecordArray, UInt8Array
from ltm_core.surface.cell_layout import CELLS, NO_LABEL, PLACE_BITS
from ltm_core.surface.observation_kernel import Limits, Pixels
from ltm_core.surface.reference_surface import ReferenceGrid, stood_at

SUM = np.dtype(
    [("place", "i4"), ("number", "f4"), ("weight", "f4"), ("moment", "f4"), ("relative_variance", "f4"), ("pose", "f4"),
     ("off_count", "f4"), ("off_weight", "f4"), ("off_moment", "f4"), ("off_pose", "f4"), ("lowest", "f4"),
     ("passed", "f4"), ("stood", "f4"), ("labelled", "f4"), ("gone", "f4"), ("stays", "f4"), ("labelled_pose", "f4"),
     ("label", "u1"), ("_", "u1", 3)]
)  # fmt: skip
"""Of one cell: sums over pixels that agree with the reference, over those that do not (off_), and the least height
above the reference at which a ray passed it (infinite: none did), and by how many sigmas of range it did; and of the
pixels that speak by their labels, how many count (`labelled`), how high it is that stood there, and the sums of the
log odds of those that say it is gone and of those that say it stays.
"""


class FrameSums(NamedTuple):
    """`used`: how many cells and tiles are in use. `cells`: their sums. `tiles`: the tiles by their number in this
    frame, and `number_of` the inverse by tile, -1 where it is not seen. `at`: by number of the tile and cell in it,
    1 + where its sums are, 0 where it is not seen.
    """

    used: Int64Array
    cells: RecordArray
    tiles: Int32Array
    number_of: Int32Array
    at: Int32Array

    @classmethod
    def empty(cls, most: int, tiles: int) -> FrameSums:
        """For at most `most` cells of a grid of `tiles` tiles; memory is claimed as it is used."""
        return cls(
            np.zeros(2, np.int64),
            np.empty(most, SUM),
            np.empty(tiles, np.int32),
            np.full(tiles, -1, np.int32),
            np.zeros((tiles, CELLS), np.int32),
        )

    @property
    def seen_tiles(self) -> Int32Array:
        """Tiles that the frame touches, in row-major order."""
        return np.sort(self.tiles[: self.used[1]])


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def clear(sums: FrameSums) -> None:
    """Forget the last frame."""
    for i in range(sums.used[0]):
        place = sums.cells[i].place
        sums.at[sums.number_of[place >> PLACE_BITS], place & (CELLS - 1)] = 0
    for i in range(sums.used[1]):
        sums.number_of[sums.tiles[i]] = -1
    sums.used[:] = 0


@njit(cache=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def sum_of(sums: FrameSums, place: int) -> int:
    """Where the sums of a cell are, cleared where it is new; -1 where there is no room for another one."""
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
        one.label = NO_LABEL
    return int(found) - 1


_EDGE = 0.5
"""Of the height of what stood, by which a pixel's neighbours may see it differently."""


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def add_labels(
    ground: ReferenceGrid,
    expected_pixels: RecordArray,
    ids: UInt8Array,
    cosines: Float32Array,
    gone: Float32Array,
    depth: Pixels,
    limits: Limits,
    sums: FrameSums,
) -> None:
    """Add up what labels (H, W) say, by cell. What finds no room in `sums` is left out.

    Args:
        expected_pixels: what the reference has for these pixels (H, W); `cosines`: their depth / slant range.
        gone: (256,) log odds by label that what stood is gone.
        depth: what the same photo measures, edge to edge over it, at its own size.

    At an edge, where ranges within a pixel differ by about as much as the height of what stood, the label may be that
    of what is beside it: it does not count.
    """
    rows, cols = ids.shape
    height, width = depth.depth.shape
    for v in range(rows):
        below = v * height // rows
        for u in range(cols):
            odds, pixel = gone[ids[v, u]], expected_pixels[v, u]
            if odds == 0.0 or pixel.place < 0 or not limits.min_range < pixel.expected < limits.max_range:
                continue
            stood = stood_at(ground, pixel.place)
            if not stood >= limits.stands or pixel.spread * pixel.incidence > _EDGE * stood:
                continue
            across = u * width // cols
            if depth.informs[below, across]:
                farthest = depth.depth[below, across] + limits.gate * depth.sigma[below, across]
                if farthest < pixel.nearest * cosines[v, u]:
                    continue
            number = sum_of(sums, pixel.place)
            if number < 0:
                continue
            one = sums.cells[number]
            one.stood = stood
            one.labelled += 1.0
            one.gone += max(odds, np.float32(0.0))
            one.stays += max(-odds, np.float32(0.0))
            one.labelled_pose += pixel.pose_variance
            if one.label == NO_LABEL:
                one.label = ids[v, u]
