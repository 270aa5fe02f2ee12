"""A slow, independent float64 tracer that visits every cell on a ray's path; tests hold the fast tracer against it.

It keeps the definition in `tracer` and shares nothing with the kernels: instead of stepping, it takes all crossings of
a ray with grid lines at once, sorts them, and in each cell puts a parabola through three heights above the surface. In
a stack of rasters, each piece of the way belongs to the finest raster that it is over.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ltm_core.base.types import BoolArray, Float32Array, Float64Array
from ltm_core.raster.dem import Dem
from ltm_core.tracing.possible_ground import PossibleGround

TOUCH = 1e-9
"""Crossings of grid lines closer than this, in cells, are one: the ray goes through a node."""
_TOUCHING = np.ones((3, 3), dtype=bool)


def trace_reference(
    dem: Dem,
    origin: Float64Array,
    directions: Float64Array,
    bend: float,
    possible: PossibleGround = PossibleGround(),
) -> Float64Array:
    """Slant ranges in metres, (N,): finite, +inf sky, NaN unknown.

    Args:
        origin: (3,) x, y, z; above the ground.
        directions: (N, 3), of any length, none of them plumb.
        bend: curvature coefficient, 1/m.
        possible: how high the ground may be where it is not known.
    """
    highest = possible.limit(float(max(np.nanmax(level.elevation) for level in dem.levels)))
    rasters = []
    for level in dem.levels:
        filled, outer = with_ceilings(level.elevation, possible.steepest * level.geometry.resolution, highest)
        rasters.append(_Raster(level, filled, outer, origin))
    ranges = np.empty(len(directions))
    for k, (east, north, up) in enumerate(directions):
        across = float(np.hypot(east, north))
        heading = east / across, -north / across
        height = _Parabola(float(origin[2]), up / across, bend)
        metres = _horizontal_range(rasters, heading, height, possible.steepest, highest)
        ranges[k] = metres * float(np.hypot(1.0, up / across))
    return ranges


def with_ceilings(elevation: Float32Array, rise: float, highest: float) -> tuple[Float32Array, BoolArray]:
    """(H, W) elevations in which each NaN node holds its ceiling (see `holes`), and which nodes are of outer holes.

    Every node takes the least of its eight neighbours plus a step, all at once, until none changes any more.
    """
    missing = np.isnan(elevation)
    hole_of_node, _ = ndimage.label(missing, structure=_TOUCHING)
    edge = np.concatenate([hole_of_node[0], hole_of_node[-1], hole_of_node[:, 0], hole_of_node[:, -1]])
    outer = missing & np.isin(hole_of_node, np.unique(edge[edge > 0]))
    filled = np.where(missing, np.float32(np.inf), elevation)
    straight, diagonal = np.float32(rise), np.float32(rise * np.sqrt(2))
    while True:
        padded = np.pad(filled, 1, constant_values=np.inf)
        beside = [padded[1:-1, :-2], padded[1:-1, 2:], padded[:-2, 1:-1], padded[2:, 1:-1]]
        corners = [padded[:-2, :-2], padded[:-2, 2:], padded[2:, :-2], padded[2:, 2:]]
        reached = np.minimum(np.min(beside, axis=0) + straight, np.min(corners, axis=0) + diagonal)
        lower = missing & (reached < filled)
        if not lower.any():
            break
        filled[lower] = reached[lower]
    highest_neighbour = ndimage.maximum_filter(np.where(missing, np.float32(-np.inf), elevation), footprint=_TOUCHING)
    filled[outer] = np.minimum(filled[outer], np.float32(highest))
    rows, cols = np.nonzero(missing & ~outer)
    if rows.size:
        holes, member_of = np.unique(hole_of_node[rows, cols], return_inverse=True)
        rim = np.full(holes.size, -np.inf, dtype=np.float32)
        np.maximum.at(rim, member_of, highest_neighbour[rows, cols])
        filled[rows, cols] = np.minimum(filled[rows, cols], rim[member_of])
    return filled, outer


class _Raster:
    """One raster, what its cells are, and where the camera stands on it."""

    def __init__(self, dem: Dem, filled: Float32Array, outer: BoolArray, origin: Float64Array) -> None:
        self.nodes, self.resolution = dem.elevation.astype(np.float64), dem.geometry.resolution
        self.hole = np.asarray(np.isnan(_corners(dem.elevation)).any(axis=0), np.bool_)
        self.outer = np.asarray(_corners(outer).any(axis=0), np.bool_)
        self.ceiling = _corners(filled).max(axis=0)
        self.oy, self.ox = (float(v) for v in dem.geometry.to_grid(origin[0], origin[1]))

    def over(self, heading: tuple[float, float]) -> tuple[float, float]:
        """The metres (near, far) between which a ray is over the nodes; near > far where it never is."""
        height, width = self.nodes.shape
        near, far = 0.0, np.inf
        for o, c, last in ((self.ox, heading[0], width - 1), (self.oy, heading[1], height - 1)):
            if c == 0:
                if not 0 <= o <= last:
                    return 1.0, 0.0
            else:
                a, b = sorted(((0 - o) / c, (last - o) / c))
                near, far = max(near, a), min(far, b)
        return near * self.resolution, far * self.resolution

    def pieces(self, near: float, far: float, heading: tuple[float, float], height: "_Parabola") -> "_Pieces":
        """What the ray meets in each cell between two metres."""
        cx, cy = heading
        first, last = near / self.resolution, far / self.resolution
        cuts = [np.array([first, last])]
        if cx != 0:
            cuts.append((np.arange(self.nodes.shape[1]) - self.ox) / cx)
        if cy != 0:
            cuts.append((np.arange(self.nodes.shape[0]) - self.oy) / cy)
        q = np.concatenate(cuts)
        q = np.sort(q[(q >= first) & (q <= last)])
        q = q[np.diff(q, prepend=-np.inf) > TOUCH]
        start, end = q[:-1], q[1:]
        middle = (start + end) / 2
        i = np.clip(np.floor(self.oy + cy * middle).astype(int), 0, self.nodes.shape[0] - 2)
        j = np.clip(np.floor(self.ox + cx * middle).astype(int), 0, self.nodes.shape[1] - 2)
        north_west, north_east, south_west, south_east = self.nodes[i + _SOUTH, j + _EAST]

        # Heights of the ray above the surface, (3, cells).
        at = np.stack([start, middle, end])
        u, v = self.ox + cx * at - j, self.oy + cy * at - i
        north = (1 - u) * north_west + u * north_east
        south = (1 - u) * south_west + u * south_east
        above = height.at(at * self.resolution) - ((1 - v) * north + v * south)

        hole = self.hole[i, j]
        root = _first_roots(*above)
        lowest = height.lowest(start * self.resolution, end * self.resolution)
        blocked = hole & (lowest <= self.ceiling[i, j])
        hit = ~hole & ~np.isnan(root)
        place = (start + np.where(hit, root, 0.0) * (end - start)) * self.resolution
        return _Pieces(hit, blocked, self.outer[i, j], place, above[0] < 0)


_SOUTH, _EAST = np.array([[0], [0], [1], [1]]), np.array([[0], [1], [0], [1]])
"""Rows and columns from a cell's first node to its four corners."""


def _corners(nodes: np.ndarray) -> np.ndarray:
    """(4, H - 1, W - 1): what the four corners of each cell have."""
    return np.stack([nodes[:-1, :-1], nodes[:-1, 1:], nodes[1:, :-1], nodes[1:, 1:]])


@dataclass(frozen=True)
class _Parabola:
    """A ray's height over horizontal metres."""

    z: float
    slope: float
    bend: float

    def at(self, r: Float64Array) -> Float64Array:
        return np.asarray(self.z + self.slope * r + self.bend * r * r)

    def lowest(self, start: Float64Array, end: Float64Array) -> Float64Array:
        lowest = np.minimum(self.at(start), self.at(end))
        if self.bend > 0:
            bottom = -self.slope / (2 * self.bend)
            lowest = np.where((start < bottom) & (bottom < end), self.at(np.array(bottom)), lowest)
        return lowest


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Cells along a ray, in order: whether it hits the ground in each, comes below the ceiling of a hole, or is over an
    outer hole; the horizontal metres of the hit; and whether it begins below the ground.
    """

    hit: BoolArray
    blocked: BoolArray
    outer: BoolArray
    place: Float64Array
    below: BoolArray


def _horizontal_range(
    rasters: list[_Raster], heading: tuple[float, float], height: _Parabola, steepest: float, highest: float
) -> float:
    """Horizontal metres to the first hit; `heading` is a unit (column, row) vector."""
    near, far = rasters[-1].over(heading)
    if near > far:
        return _beyond(height, 0.0, steepest, highest)
    pieces: list[_Pieces] = []
    covered: tuple[float, float] | None = None
    for raster in rasters:  # from the finest outwards: each adds what lies before and after those within it
        near, far = raster.over(heading)
        if near > far:
            continue
        if covered is None:
            pieces = [raster.pieces(near, far, heading, height)]
        else:
            before = raster.pieces(near, covered[0], heading, height)
            after = raster.pieces(covered[1], far, heading, height)
            pieces = [before, *pieces, after]
        covered = near, far
    hit, blocked, outer, below = (
        np.concatenate([getattr(p, name) for p in pieces]) for name in ("hit", "blocked", "outer", "below")
    )
    place = np.concatenate([p.place for p in pieces])
    if outer.all():
        return _beyond(height, 0.0, steepest, highest)
    entered = int(np.argmin(outer))  # what is before the first cell of the DEM counts as free
    blocked[:entered] = False
    ends = np.flatnonzero(hit | blocked)
    if ends.size == 0:
        return _beyond(height, far, steepest, highest)
    first = int(ends[0])
    if blocked[first] or (first == entered and below[first]):
        return np.nan
    return float(place[first])


def _beyond(height: _Parabola, leaves: float, steepest: float, highest: float) -> float:
    """+inf where a ray leaves climbing and no ground ahead can be as high or as steep; else NaN."""
    if height.slope + 2 * height.bend * leaves < 0:
        return np.nan
    return np.inf if height.slope >= steepest or height.at(np.array(leaves)) > highest else np.nan


def _first_roots(f0: Float64Array, f_half: Float64Array, f1: Float64Array) -> Float64Array:
    """First place in [0, 1] where the parabola through (0, f0), (1/2, f_half), (1, f1) is not positive; NaN where
    none is.
    """
    a = 2 * (f0 - 2 * f_half + f1)
    b = -3 * f0 + 4 * f_half - f1
    with np.errstate(invalid="ignore", divide="ignore"):
        bottom = np.clip(np.where(a > 0, -b / (2 * a), 1.0), 0.0, 1.0)
        least = np.minimum(f1, f0 + bottom * (b + a * bottom))
        discriminant = np.sqrt(np.maximum(b * b - 4 * a * f0, 0.0))
        root = np.where(b <= 0, 2 * f0 / (discriminant - b), (-b - discriminant) / (2 * a))
        root = np.where(f0 <= 0, 0.0, np.clip(root, 0.0, 1.0))
        return np.where((f0 <= 0) | (least <= 0), root, np.nan)
