"""What stands in a cell must hide what is behind it: a camera that sees through it caps its height.

Rays that pass under the reference are walked where they do so (`observe_kernel`). What is held to stand *above* the
reference, candidates and accepted growth, is few cells: each is looked for in the image instead.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ltm_core.camera import Camera
from ltm_core.grid import GridGeometry
from ltm_core.pose import Pose
from ltm_core.terrain.cell_kernel import Cells, Rules, take

Image = NDArray[np.float32]
Indices = NDArray[np.int32]

INSIDE = 0.6
"""Of a thing's height above the reference: a point that is well within it."""
FIRM_LOOKS = 2.5
"""Looks from which on it takes independent views to take growth back; before, one that sees through it is enough."""


class Standing(NamedTuple):
    """Cells in memory where something is held to stand above the reference, (N,) each: slot, cell of the tile, map
    coordinates of a point well inside the thing, its height above the reference, and whether it is a candidate.
    """

    slot: Indices
    cell: Indices
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    dz: Image
    candidate: NDArray[np.bool_]


def see_through(
    cells: Cells,
    places: NDArray[np.int32],
    tile: int,
    surface: Image,
    geometry: GridGeometry,
    camera: Camera,
    pose: Pose,
    slant: Image,
    sigma: Image,
    measured: NDArray[np.bool_],
    seconds: int,
    bit: int,
    rules: Rules,
    reach: tuple[float, float],
) -> int:
    """Drop what this image sees through, or count it against growth that several looks have seen; how many cells.

    What the image itself has brought is looked at too: what stands, stands on something, so that whatever hovers in the
    air, as smoke does or a bird, is seen through under its own place.

    Args:
        cells, places: the state in memory, and (N, 3) slot, tile row and tile column of the tiles in it.
        slant, sigma, measured: (H, W) of `camera`; a cell is seen through where all pixels about it see farther.
        reach: metres, between which things are looked for.
    """
    standing = _standing(cells, places, tile, surface, rules.threshold / INSIDE, geometry)
    if len(standing.slot) == 0:
        return 0
    points = np.column_stack([standing.x, standing.y, standing.z])
    away = np.linalg.norm(points - pose.position, axis=1)
    pixels = camera.project(pose.to_optical(points))
    with np.errstate(invalid="ignore"):
        inside = (
            (pixels[:, 0] > 0.5)
            & (pixels[:, 1] > 0.5)
            & (pixels[:, 0] < camera.width - 1.5)
            & (pixels[:, 1] < camera.height - 1.5)
            & (away > reach[0])
            & (away < reach[1])
        )
    u, v = (np.where(inside, pixels[:, i], 1).round().astype(np.int32) for i in (0, 1))
    through = inside & _passed(u, v, away, slant, sigma, measured, rules.gate)
    return int(_apply(cells, Standing(*(a[through] for a in standing)), seconds, bit, rules))


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _passed(
    u: Indices,
    v: Indices,
    away: NDArray[np.float64],
    slant: Image,
    sigma: Image,
    measured: NDArray[np.bool_],
    gate: float,
) -> NDArray[np.bool_]:
    """Whether all nine pixels about (u, v), (N,) each and none at the image's edge, surely see farther than `away`."""
    found = np.ones(len(u), np.bool_)
    for i in range(len(u)):
        for row in range(v[i] - 1, v[i] + 2):
            for col in range(u[i] - 1, u[i] + 2):
                reached, doubt = slant[row, col], sigma[row, col]
                surely = reached == np.inf or (doubt > 0 and reached - gate * doubt > away[i])
                if not (measured[row, col] and surely):
                    found[i] = False
    return found


def _standing(
    cells: Cells, places: NDArray[np.int32], tile: int, surface: Image, least: float, geometry: GridGeometry
) -> Standing:
    slot, cell, dz, candidate = _find(cells, places[:, 0], np.float32(least))
    tiles = places[np.searchsorted(places[:, 0], slot), 1:]
    row, col = tiles[:, 0] * tile + cell // tile, tiles[:, 1] * tile + cell % tile
    height, width = surface.shape
    row, col = np.minimum(row, height - 1), np.minimum(col, width - 1)
    x, y = geometry.to_map(row, col)
    return Standing(slot, cell, x, y, surface[row, col] + INSIDE * dz.astype(np.float64), dz, candidate)


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _find(cells: Cells, slots: Indices, least: float) -> tuple[Indices, Indices, Image, NDArray[np.bool_]]:
    """Slot, cell, height and whether it is a candidate; a cell with both is listed twice."""
    found = 0
    for turn in range(2):
        if turn == 1:
            slot_of, cell_of = np.empty(found, np.int32), np.empty(found, np.int32)
            dz, candidate = np.empty(found, np.float32), np.empty(found, np.bool_)
            found = 0
        for slot in slots:
            for k in range(cells.dz.shape[1]):
                if cells.c_looks[slot, k] > 0 and cells.c_dz[slot, k] > least:
                    if turn == 1:
                        slot_of[found], cell_of[found] = slot, k
                        dz[found], candidate[found] = cells.c_dz[slot, k], True
                    found += 1
                if cells.looks[slot, k] > 0 and cells.dz[slot, k] > least:
                    if turn == 1:
                        slot_of[found], cell_of[found] = slot, k
                        dz[found], candidate[found] = cells.dz[slot, k], False
                    found += 1
    return slot_of, cell_of, dz, candidate


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _apply(cells: Cells, standing: Standing, seconds: int, bit: int, rules: Rules) -> int:
    for i in range(len(standing.slot)):
        slot, k = standing.slot[i], standing.cell[i]
        if standing.candidate[i]:
            cells.c_looks[slot, k] = 0
        elif cells.looks[slot, k] < FIRM_LOOKS:
            cells.looks[slot, k] = cells.weight[slot, k] = 0
            cells.cameras[slot, k] = 0
            cells.frames[slot, k] = 0
        else:
            limit = np.float32(standing.dz[i] * INSIDE)
            take(
                cells,
                slot,
                k,
                limit,
                rules.carve_variance,
                rules.carve_variance,
                np.float32(0.0),
                True,
                seconds,
                bit,
                rules,
            )
    return len(standing.slot)
