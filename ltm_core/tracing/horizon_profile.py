"""Horizon profile of a camera position: a lower bound of the range at which a ray in each direction meets the ground.

Directions are cut into wedges. Each ray has a *major* axis, the grid axis that it mostly follows, and moves `t` (at
most 1 either way) cells along the other, *minor*, axis for each cell along the major; a wedge is a small interval of
t on one of four *faces* (+x, -x, +y, -y). Distance d along the major axis is what all ranges here are counted in, so
that nothing needs a square root: a ray's height is z(d) = oz + s d + bend (1 + t^2) d^2.

Seen from the camera, a height h at distance d has the *tangent* (h - oz) / d - bend (1 + t^2) d: the slope s of the
ray that meets it. Going outwards by *strips* (the cells between two neighbouring node lines across the major axis), a
wedge lists each strip in which the highest tangent so far is exceeded, with the new highest. The list is monotone, so
the first entry whose tangent reaches a ray's slope names the strip before which the ray hits nothing; where there is
none, it hits nothing at all. Tangents are rounded up and bound everything between the edges of the wedge."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.kernels import helper, in_parallel, kernel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int32Array, Int64Array
from ltm_core.tracing.holes import filled_at
from ltm_core.tracing.pyramid import LEAF
from ltm_core.tracing.pyramid_traversal import AFTER, RasterStage, TerrainRaster

WEDGES_A_FACE = 1024
SECTOR = 64
"""Number of wedges that are built together."""
_MOST_ENTRIES = 4096
_FEWEST = 16
"""Minimum number of wedges for a thread."""
# Tangents are raised by this, well above the rounding of any ray's height, and of the tangent itself to float32 (6e-8).
_RELATIVE, _ABSOLUTE = 3e-7, 1e-9
# Cells: how far a wedge is widened so that no ray of it slips past its edge by rounding.
_MARGIN = 1e-6
# Beyond these distances (cells), strips of this level and below are not told apart.
_FINE_CELLS = 700.0


class Wedges(NamedTuple):
    """Profiles of the wedges built so far; index: face * WEDGES_A_FACE + wedge."""

    start: Int64Array
    """Start of a wedge's entries."""
    entries: Int32Array
    """Number of entries of a wedge; -1 if it is not built."""
    highest: Float32Array
    """Last tangent of a wedge; +inf if it is not built."""
    tangent: Float32Array
    """Highest tangent of an entry up to the end of a strip, increasing within a wedge."""
    node: Int32Array
    """Node line of an entry at which that strip begins."""


def no_wedges() -> Wedges:
    """Return an empty profile."""
    total = 4 * WEDGES_A_FACE
    return Wedges(
        np.zeros(total, np.int64),
        np.full(total, -1, np.int32),
        np.full(total, np.inf, np.float32),
        np.empty(0, np.float32),
        np.empty(0, np.int32),
    )


def extended(wedges: Wedges, wanted: Int64Array, ground: TerrainRaster, stage: RasterStage) -> Wedges:
    """Return `wedges` with the missing ones of the `wanted` indices added, over the stage's part of the raster."""
    missing = wanted[wedges.entries[wanted] < 0]
    if missing.size == 0:
        return wedges
    count, start = wedges.entries.copy(), wedges.start.copy()
    found = np.empty(missing.size, np.int32)
    parts: dict[int, list[NDArray[Any]]] = {}

    def walk(first: int, last: int) -> None:
        tangent = np.empty((SECTOR, _MOST_ENTRIES), np.float32)
        node = np.empty((SECTOR, _MOST_ENTRIES), np.int32)
        for begin in range(first, last, SECTOR):
            part = slice(begin, min(begin + SECTOR, last))
            _walk_wedges(ground, stage, missing[part], tangent, node, found[part])
            numbers = found[part].tolist()
            parts[begin] = [np.concatenate([of[k, :n] for k, n in enumerate(numbers)]) for of in (tangent, node)]

    in_parallel(walk, missing.size, _FEWEST)
    count[missing], start[missing] = found, wedges.tangent.size + np.cumsum(found, dtype=np.int64) - found
    tangents = np.concatenate([wedges.tangent, *(parts[begin][0] for begin in sorted(parts))])
    nodes = np.concatenate([wedges.node, *(parts[begin][1] for begin in sorted(parts))])
    highest = wedges.highest.copy()
    # A wedge that never comes over this stage's part has no entry.
    highest[missing] = -np.inf
    rising = missing[found > 0]
    highest[rising] = tangents[start[rising] + count[rising] - 1]
    return Wedges(start, count, highest, tangents, nodes)


@kernel(nogil=True)
def _walk_wedges(
    ground: TerrainRaster,
    stage: RasterStage,
    wanted: Int64Array,
    tangent: Float32Array,
    node: Int32Array,
    count: Int32Array,
) -> None:
    """Fill the entries of the wedges `wanted` (N,) and their numbers `count`."""
    oz, bend = stage.oz, stage.bend
    for k in range(wanted.size):
        index = wanted[k]
        face = index // WEDGES_A_FACE
        wedge = index - face * WEDGES_A_FACE
        t0 = wedge * (2.0 / WEDGES_A_FACE) - 1.0 - 1e-12
        t1 = (wedge + 1) * (2.0 / WEDGES_A_FACE) - 1.0 + 1e-12
        least_t = 0.0 if t0 < 0.0 < t1 else min(abs(t0), abs(t1))
        most_t = max(abs(t0), abs(t1))
        along_x = face < 2
        forward = face % 2 == 0
        sign = 1 if forward else -1
        o_major, o_minor = (stage.ox, stage.oy) if along_x else (stage.oy, stage.ox)
        n_major = (ground.width if along_x else ground.height) - 1
        n_minor = (ground.height if along_x else ground.width) - 1
        # The least drop below the straight line, so that tangents come out too high rather than too low.
        drop = bend * (1.0 + (least_t * least_t if bend >= 0.0 else most_t * most_t))

        highest = -np.inf
        entries = 0
        begin = _least_exit(stage, along_x, forward, t0, t1) if stage.part == AFTER else 0.0
        cell = min(max(math.floor(o_major + sign * begin), 0), n_major - 1)
        level: Any = np.int64(0)  # else `_highest` is compiled for the literal, too
        levels = ground.offsets.size
        while 0 <= cell < n_major:
            low = (cell >> level) << level
            high = min(low + (1 << level), n_major)
            d0 = max(sign * ((cell if forward else cell + 1) - o_major), begin)
            d1 = sign * ((high if forward else low) - o_major)
            m_low = o_minor + min(t0 * d0, t0 * d1) - _MARGIN
            m_high = o_minor + max(t1 * d0, t1 * d1) + _MARGIN
            if m_high < 0.0 or m_low > n_minor:
                # Strips of blocks are long: the wedge may leave the raster, or not yet have, within one.
                if level == 0:
                    break
                level = level - 1 if level > LEAF else 0
                continue
            j0 = min(max(math.floor(m_low), 0), n_minor - 1)
            j1 = min(math.floor(m_high), n_minor - 1)
            h = _highest(ground, along_x, level, low, j0, j1)
            rise = h - oz
            t = rise / (d0 if rise >= 0.0 else d1) - drop * (d0 if bend >= 0.0 else d1)
            # A camera on a node line looks away from the strip behind it, where a fall over -0 would be a wall.
            if d1 > 0.0 and not t <= highest:
                if level > 0 and d0 < _FINE_CELLS * level:
                    level = level - 1 if level > LEAF else 0
                    continue
                highest = t + abs(t) * _RELATIVE + _ABSOLUTE
                if entries < tangent.shape[1]:
                    node[k, entries] = cell if forward else cell + 1
                    entries += 1
                tangent[k, entries - 1] = np.float32(highest)
                highest = float(tangent[k, entries - 1])
            block = low >> level
            cell = high if forward else low - 1
            above = 1 if level > 0 else LEAF
            if ((cell >> level) ^ block) >> above != 0 and level + above < levels:
                level += above
        count[k] = entries


@helper()
def _least_exit(stage: RasterStage, along_x: bool, forward: bool, t0: float, t1: float) -> float:
    """Return the least major distance at which a ray of the wedge t0 to t1 leaves the next finer raster."""
    west, north, east, south = stage.finer
    if along_x:
        least, low, high = (east if forward else -west), north, south
    else:
        least, low, high = (south if forward else -north), west, east
    for t in (t0, t1):
        if t > 0.0:
            least = min(least, high / t)
        elif t < 0.0:
            least = min(least, low / t)
    return max(least - _MARGIN, 0.0)


@helper()
def _highest(ground: TerrainRaster, along_x: bool, level: int, major: int, j0: int, j1: int) -> float:
    """Return an upper bound of the ground, known or possible, in a strip at cell `major`, minor cells j0 to j1."""
    highest = -np.inf
    if level == 0:
        step, across = (ground.width, 1) if along_x else (1, ground.width)
        at = j0 * step + major * across
        first = at
        top = np.float32(-np.inf)
        unknown = False
        for _ in range(j1 - j0 + 2):
            near, far = ground.nodes[np.uint64(at)], ground.nodes[np.uint64(at + across)]
            top = near if near > top else top
            top = far if far > top else top
            unknown = unknown or near + far != near + far
            at += step
        if not unknown:
            return float(top)
        at = first
        for _ in range(j1 - j0 + 2):
            for node in (at, at + across):
                highest = max(highest, float(filled_at(ground.nodes, ground.holes, node)))
            at += step
        return highest
    step, across = (ground.widths[level], 1) if along_x else (1, ground.widths[level])
    first, last = j0 >> level, j1 >> level
    at = ground.offsets[level] + first * step + (major >> level) * across
    for _ in range(last - first + 1):
        highest = max(highest, float(ground.bounds[at]))
        at += step
    return highest


@kernel(nogil=True)
def mark_sectors(rays: Float64Array, rotation: Float64Array, every: int, marked: BoolArray) -> None:
    """Mark the sectors that an image (H, W, 3) of rays covers, from each `every`-th pixel with a margin; a ray in a
    missed one is traced without a profile."""
    for i in range(0, rays.shape[0], every):
        for j in range(0, rays.shape[1] + every - 1, every):
            a, b, c = rays[i, min(j, rays.shape[1] - 1)]
            east = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2] * c
            north = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2] * c
            if not (abs(east) > 1e-3 or abs(north) > 1e-3):
                continue
            along_x = abs(east) >= abs(north)
            major, minor = (east, -north) if along_x else (-north, east)
            first = ((0 if along_x else 2) + (0 if major > 0.0 else 1)) * WEDGES_A_FACE
            place = int((minor / abs(major) + 1.0) * (0.5 * WEDGES_A_FACE))
            wedge = first + min(max(place, 0), WEDGES_A_FACE - 1)
            for near in (wedge - every, wedge, wedge + every):
                marked[min(max(near, first), first + WEDGES_A_FACE - 1) // SECTOR] = True
