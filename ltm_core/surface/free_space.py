"""Free-space test: a camera that sees through an object in a cell limits the cell's height.

What stands above the reference is few cells: each is projected into the image."""

import numpy as np

from ltm_core.base.kernels import kernel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int32Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.surface.cell_layout import TILE, TileCells
from ltm_core.surface.cell_update import Rules, update_cell
from ltm_core.surface.observation_kernel import Pixels

INSIDE = 0.6
"""Share of an object's height above the reference at which a point is well inside. Objects lower than the threshold
there are ignored."""
FIRM_LOOKS = 2.5
"""Number of observations above which independent views are needed to revert growth; below, one view through it is
enough."""


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
) -> None:
    """Drop objects that this image sees through, also those that it has brought itself, because what hovers is smoke or
    a bird; count it against growth that several observations have seen.

    `places`: (N, 3) slot, tile row and tile column of the tiles in memory. `camera`: of the pixels in use. `reach`:
    minimum and maximum distance of objects in metres."""
    tile, cell = np.nonzero(cells.high[places[:, 0]])
    slot, top, left = places[tile].T
    records = cells.records[slot, cell]
    tall = [(records[c + "looks"] > 0) & (records[c + "dz"] > rules.looked_for) for c in ("c_", "")]
    cells.high[slot, cell] = tall[0] | tall[1]
    # Of each cell the candidate comes first, then the estimate.
    which = np.concatenate([np.flatnonzero(one) for one in tall])
    candidate = np.arange(len(which)) < np.count_nonzero(tall[0])
    dz = np.where(candidate, records["c_dz"][which], records["dz"][which])
    row = np.minimum(top * TILE + cell // TILE, len(surface) - 1)[which]
    col = np.minimum(left * TILE + cell % TILE, surface.shape[1] - 1)[which]
    point = np.stack([*geometry.to_map(row, col), surface[row, col] + INSIDE * dz.astype(np.float64)], axis=-1)
    away = np.linalg.norm(point - pose.position, axis=1)
    near = np.flatnonzero((reach[0] < away) & (away < reach[1]))
    at = camera.project(pose.to_optical(point[near])) - 0.5
    with np.errstate(invalid="ignore"):
        inside = ((at > 0) & (at < (camera.width - 2, camera.height - 2))).all(axis=1)
    u, v = (at[inside] + 0.5).round().astype(np.int32).T
    kept = near[inside]
    kept = kept[_passed(u, v, away[kept], pixels, rules.gate)]
    objects = slot[which[kept]], cell[which[kept]].astype(np.int32), dz[kept], candidate[kept]
    _apply(cells, *objects, seconds, bit, rules)


def _passed(u: Int32Array, v: Int32Array, away: Float64Array, pixels: Pixels, gate: float) -> BoolArray:
    """Return whether all nine pixels about (u, v), (N,) each and none at the image's edge, surely see farther than
    `away`."""
    rows = v[:, None] + np.repeat([-1, 0, 1], 3)
    cols = u[:, None] + np.tile([-1, 0, 1], 3)
    along, at = pixels.cosines[rows, cols], (rows * pixels.step, cols * pixels.step)
    reached, doubt = pixels.depth[at] / along, pixels.sigma[at] / along
    with np.errstate(invalid="ignore"):
        surely = (doubt > 0) & (reached - np.float64(gate) * doubt > away[:, None])
    return np.asarray(((pixels.informs[at] > 0) & ((reached == np.inf) | surely)).all(axis=1))


@kernel()
def _apply(
    cells: TileCells,
    slots: Int32Array,
    places: Int32Array,
    dz: Float32Array,
    candidate: BoolArray,
    seconds: int,
    bit: int,
    rules: Rules,
) -> None:
    """Drop (N,) objects, or count this image against them: slot, cell of the tile, the object's height above the
    reference in metres, and whether it is a candidate."""
    for i in range(len(slots)):
        slot, k = slots[i], places[i]
        e = cells.records[slot, k]
        if candidate[i]:
            e.c_looks = 0
        elif e.looks < FIRM_LOOKS:
            e.looks = e.weight = 0
            e.cameras = 0
            e.frames = 0
        else:
            limit, own = np.float32(dz[i] * INSIDE), np.float32(rules.carve_variance)
            update_cell(
                cells, slot, k, limit, own, own, np.float32(0.0), True, seconds, bit, rules.independent_after, rules
            )
