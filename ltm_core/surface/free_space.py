"""Free-space test: a camera that sees through an object in a cell limits the cell's height.

What stands above the reference is few cells: each is projected into the image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltm_core.base.kernels import kernel, prefetch
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int32Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.surface.cell_layout import CELLS, TILE, TileCells
from ltm_core.surface.cell_update import Rules, update_cell
from ltm_core.surface.observation_kernel import Pixels

INSIDE = 0.6
"""Share of an object's height above the reference at which a point is well inside. Objects lower than the threshold
there are ignored."""
FIRM_LOOKS = 2.5
"""Number of observations above which independent views are needed to revert growth; below, one view through it is
enough."""
_AT_ONCE = 4 * CELLS
_WIDER = 1.05
"""Factor on a camera's view within which objects are looked up and their pixels computed."""


class ElevatedCells(NamedTuple):
    """Cells in memory with an object above the reference, (N,) each: slot, cell of the tile, map coordinates of a point
    well inside the object, its distance, its height above the reference, and whether it is a candidate."""

    slot: Int32Array
    cell: Int32Array
    point: Float64Array
    away: Float64Array
    dz: Float32Array
    candidate: BoolArray

    @classmethod
    def empty(cls, count: int) -> ElevatedCells:
        """Return an empty array with room for `count` cells."""
        point, away = np.empty((count, 3)), np.empty(count)
        dz, candidate = np.empty(count, np.float32), np.empty(count, np.bool_)
        return cls(np.empty(count, np.int32), np.empty(count, np.int32), point, away, dz, candidate)

    def where(self, part: slice | BoolArray) -> ElevatedCells:
        return ElevatedCells(*(array[part] for array in self))  # type: ignore[arg-type]


class CameraBounds(NamedTuple):
    """Position and maximum view of a camera: position, rotation to the map, |x / z| and |y / z| of its rays, and the
    minimum and maximum distance of objects."""

    position: Float64Array
    rotation: Float64Array
    aside: float
    upwards: float
    nearest: float
    farthest: float


def see_through(
    cells: TileCells,
    places: Int32Array,
    surface: Float32Array,
    geometry: GridGeometry,
    camera: Camera,
    pose: Pose,
    pixels: Pixels,
    seconds: int,
    bit: int,
    rules: Rules,
    reach: tuple[float, float],
) -> int:
    """Drop objects that this image sees through, also those that it has brought itself, because what hovers is smoke or
    a bird; count it against growth that several observations have seen. Return the number of cells.

    `places`: (N, 3) slot, tile row and tile column of the tiles in memory. `camera`: of the pixels in use. `reach`:
    minimum and maximum distance of objects in metres."""
    rows, cols = (np.append(np.arange(0, n - 1, 16), n - 1) for n in (camera.height, camera.width))
    rays = camera.rays()[np.ix_(rows, cols)]
    aside, upwards = (_WIDER * float(np.abs(rays[..., i] / rays[..., 2]).max()) for i in (0, 1))
    place = CameraBounds(
        np.ascontiguousarray(pose.position), np.ascontiguousarray(pose.rotation), aside, upwards, *map(float, reach)
    )
    corner = geometry.x_min, geometry.y_max, geometry.resolution
    # A few thousand at a time: what is computed of them stays in the processor's caches.
    room, begin, seen = ElevatedCells.empty(_AT_ONCE), 0, 0
    while begin < len(places):
        count, begin = _find(cells, places, begin, surface, corner, rules.looked_for, place, room)
        some = room.where(slice(0, count))
        through = _seen_through(some, camera, pose, pixels, rules.gate)
        seen += _apply(cells, some.where(through), seconds, bit, rules)
    return seen


def _seen_through(standing: ElevatedCells, camera: Camera, pose: Pose, pixels: Pixels, gate: float) -> BoolArray:
    at = camera.project(pose.to_optical(standing.point))
    with np.errstate(invalid="ignore"):
        inside = (
            (at[:, 0] > 0.5) & (at[:, 1] > 0.5) & (at[:, 0] < camera.width - 1.5) & (at[:, 1] < camera.height - 1.5)
        )
    u, v = (np.where(inside, at[:, i], 1).round().astype(np.int32) for i in (0, 1))
    return np.asarray(inside & _passed(u, v, standing.away, pixels, gate), np.bool_)


@kernel()
def _passed(u: Int32Array, v: Int32Array, away: Float64Array, pixels: Pixels, gate: float) -> BoolArray:
    """Return whether all nine pixels about (u, v), (N,) each and none at the image's edge, surely see farther than
    `away`."""
    found = np.ones(len(u), np.bool_)
    step = pixels.step
    for i in range(len(u)):
        for row in range(v[i] - 1, v[i] + 2):
            for col in range(u[i] - 1, u[i] + 2):
                along = pixels.cosines[row, col]
                reached, doubt = (
                    pixels.depth[row * step, col * step] / along,
                    pixels.sigma[row * step, col * step] / along,
                )
                surely = reached == np.inf or (doubt > 0 and reached - gate * doubt > away[i])
                if not (pixels.informs[row * step, col * step] and surely):
                    found[i] = False
                    break
            if not found[i]:
                break
    return found


@kernel()
def _find(
    cells: TileCells,
    places: Int32Array,
    begin: int,
    surface: Float32Array,
    corner: tuple[float, float, float],
    least: float,
    place: CameraBounds,
    found: ElevatedCells,
) -> tuple[int, int]:
    """Fill `found` with cells higher than `least` that the camera may see, from the tile `begin` of `places` on; return
    their number, and where to go on. `corner`: x and y of the grid's north-west corner, and its cell size."""
    count = 0
    height, width = surface.shape
    m = place.rotation
    high = np.empty(CELLS, np.int32)
    for number in range(begin, len(places)):
        if count + 2 * CELLS > len(found.slot):
            return count, number
        slot, top, left = places[number, 0], places[number, 1] * TILE, places[number, 2] * TILE
        listed = 0
        for k in range(CELLS):
            if cells.high[slot, k]:
                high[listed] = k
                listed += 1
                prefetch(cells.estimate, slot * CELLS + k)
                prefetch(surface, (top + k // TILE) * width + left + k % TILE)
        for k in high[:listed]:
            e = cells.estimate[slot, k]
            cells.high[slot, k] = 0
            for candidate in (True, False):
                dz = e.c_dz if candidate else e.dz
                if not ((e.c_looks if candidate else e.looks) > 0 and dz > least):
                    continue
                cells.high[slot, k] = 1
                row = min(top + k // TILE, height - 1)
                col = min(left + k % TILE, width - 1)
                x = corner[0] + (col + 0.5) * corner[2]
                y = corner[1] - (row + 0.5) * corner[2]
                z = surface[row, col] + INSIDE * np.float64(dz)
                px, py, pz = x - place.position[0], y - place.position[1], z - place.position[2]
                away = np.sqrt(px * px + py * py + pz * pz)
                ahead = m[0, 2] * px + m[1, 2] * py + m[2, 2] * pz
                if (
                    not place.nearest < away < place.farthest
                    or abs(m[0, 0] * px + m[1, 0] * py + m[2, 0] * pz) > place.aside * ahead
                    or abs(m[0, 1] * px + m[1, 1] * py + m[2, 1] * pz) > place.upwards * ahead
                ):
                    continue
                found.slot[count], found.cell[count] = slot, k
                found.point[count, 0], found.point[count, 1], found.point[count, 2] = x, y, z
                found.away[count], found.dz[count], found.candidate[count] = away, dz, candidate
                count += 1
    return count, len(places)


@kernel()
def _apply(cells: TileCells, standing: ElevatedCells, seconds: int, bit: int, rules: Rules) -> int:
    for i in range(len(standing.slot)):
        slot, k = standing.slot[i], standing.cell[i]
        e = cells.estimate[slot, k]
        if standing.candidate[i]:
            e.c_looks = 0
        elif e.looks < FIRM_LOOKS:
            e.looks = e.weight = 0
            e.cameras = 0
            e.frames = 0
        else:
            limit, own = np.float32(standing.dz[i] * INSIDE), np.float32(rules.carve_variance)
            update_cell(
                cells, slot, k, limit, own, own, np.float32(0.0), True, seconds, bit, rules.independent_after, rules
            )
    return len(standing.slot)
