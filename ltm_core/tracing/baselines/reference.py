"""A slow, independent float64 tracer that visits every cell on a ray's path; tests hold the fast tracer against it.

It keeps the definition in `tracer` and shares nothing with the kernels: instead of stepping, it takes all crossings of
a ray with grid lines at once, sorts them, and in each cell puts a parabola through three heights above the surface. In
a stack of rasters, each piece of the way belongs to the finest raster that it is over.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from ltm_core.dem import Dem
from ltm_core.grid import GridGeometry
from ltm_core.types import BoolArray, Float32Array, Float64Array

TOUCH = 1e-9
"""Crossings of grid lines closer than this, in cells, are one: the ray goes through a node."""
_TOUCHING = np.ones((3, 3), dtype=bool)


def trace_reference(dem: Dem, origin: Float64Array, directions: Float64Array, bend: float) -> Float64Array:
    """Slant ranges in metres, (N,): finite, +inf sky, NaN unknown.

    Args:
        origin: (3,) x, y, z; above the ground.
        directions: (N, 3), of any length, none of them plumb.
        bend: curvature coefficient, 1/m.
    """
    rasters = [_Raster(level.elevation, with_ceilings(level.elevation), level.geometry, origin) for level in dem.levels]
    ranges = np.empty(len(directions))
    for k, (east, north, up) in enumerate(directions):
        across = float(np.hypot(east, north))
        heading = east / across, -north / across
        metres = _horizontal_range(rasters, float(origin[2]), heading, up / across, bend)
        ranges[k] = metres * float(np.hypot(1.0, up / across))
    return ranges


def with_ceilings(elevation: Float32Array) -> Float32Array:
    """(H, W) elevations in which each NaN node of an enclosed hole holds the hole's ceiling (see `holes`); NaN nodes of
    outer holes stay NaN.
    """
    missing = np.isnan(elevation)
    hole_of_node, _ = ndimage.label(missing, structure=_TOUCHING)
    edge = np.concatenate([hole_of_node[0], hole_of_node[-1], hole_of_node[:, 0], hole_of_node[:, -1]])
    enclosed = missing & ~np.isin(hole_of_node, np.unique(edge[edge > 0]))
    if not enclosed.any():
        return elevation
    highest_neighbour = ndimage.maximum_filter(np.where(missing, np.float32(-np.inf), elevation), footprint=_TOUCHING)
    rows, cols = np.nonzero(enclosed)
    holes, member_of = np.unique(hole_of_node[rows, cols], return_inverse=True)
    ceiling = np.full(holes.size, -np.inf, dtype=np.float32)
    np.maximum.at(ceiling, member_of, highest_neighbour[rows, cols])
    filled = elevation.copy()
    filled[rows, cols] = ceiling[member_of]
    return filled


class _Raster:
    """One raster and where the camera stands on it."""

    def __init__(self, nodes: Float32Array, filled: Float32Array, geometry: GridGeometry, origin: Float64Array) -> None:
        self.nodes, self.filled, self.resolution = nodes, filled, geometry.resolution
        self.oy, self.ox = (float(v) for v in geometry.to_grid(origin[0], origin[1]))

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

    def pieces(self, near: float, far: float, heading: tuple[float, float], height: _Parabola) -> _Pieces:
        """What the ray meets in each cell between two metres."""
        cx, cy = heading
        first, last = near / self.resolution, far / self.resolution
        cuts = [np.array([first, last])]
        if cx != 0:
            cuts.append((np.arange(self.nodes.shape[1]) - self.ox) / cx)
        if cy != 0:
            cuts.append((np.arange(self.nodes.shape[0]) - self.oy) / cy)
        q = np.unique(np.concatenate(cuts))
        q = q[(q >= first) & (q <= last)]
        q = q[np.diff(q, prepend=-np.inf) > TOUCH]
        start, end = q[:-1], q[1:]
        middle = (start + end) / 2
        i = np.clip(np.floor(self.oy + cy * middle).astype(int), 0, self.nodes.shape[0] - 2)
        j = np.clip(np.floor(self.ox + cx * middle).astype(int), 0, self.nodes.shape[1] - 2)
        nodes = self.nodes
        corners = [nodes[i, j], nodes[i, j + 1], nodes[i + 1, j], nodes[i + 1, j + 1]]
        north_west, north_east, south_west, south_east = (c.astype(np.float64) for c in corners)

        def above(q: Float64Array) -> Float64Array:
            u, v = self.ox + cx * q - j, self.oy + cy * q - i
            north = (1 - u) * north_west + u * north_east
            south = (1 - u) * south_west + u * south_east
            return np.asarray(height.at(q * self.resolution) - ((1 - v) * north + v * south))

        filled = self.filled
        ceilings = np.stack([filled[i, j], filled[i, j + 1], filled[i + 1, j], filled[i + 1, j + 1]])
        hole = np.isnan(north_west + north_east + south_west + south_east)
        outer = np.isnan(ceilings).any(axis=0)
        root = _first_roots(above(start), above(middle), above(end))
        lowest = height.lowest(start * self.resolution, end * self.resolution)
        with np.errstate(invalid="ignore"):
            blocked = hole & ~outer & (lowest <= np.where(outer, np.inf, ceilings.max(axis=0)))
        hit = ~hole & ~np.isnan(root)
        place = (start + np.where(hit, root, 0.0) * (end - start)) * self.resolution
        return _Pieces(hit, blocked, outer, place, above(start) < 0)


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
    """Cells along a ray, in order: whether it hits the ground in each, meets an enclosed hole below its ceiling, or is
    over an outer hole; the horizontal metres of the hit; and whether it begins below the ground.
    """

    hit: BoolArray
    blocked: BoolArray
    outer: BoolArray
    place: Float64Array
    below: BoolArray


def _horizontal_range(
    rasters: list[_Raster], z: float, heading: tuple[float, float], slope: float, bend: float
) -> float:
    """Horizontal metres to the first hit; `heading` is a unit (column, row) vector."""
    near, far = rasters[-1].over(heading)
    if near > far:
        return np.inf if slope >= 0 else np.nan
    beyond = np.inf if slope + 2 * bend * far >= 0 else np.nan
    height = _Parabola(z, slope, bend)
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
    ends = np.flatnonzero(hit | blocked)
    if ends.size == 0:
        return float(beyond)
    first = int(ends[0])
    if blocked[first]:
        return np.nan
    known_before = ~outer[:first]
    entered = int(np.argmax(known_before)) if known_before.any() else first
    lost = bool(outer[entered:first].any())
    emerges_below = entered == first and below[first]
    if lost or emerges_below:
        return np.nan
    return float(place[first])


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
