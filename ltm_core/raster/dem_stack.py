"""Combine several elevation rasters into one terrain, shared within the process.

Fire cameras see ridges tens of kilometres away, where a raster of 1 m is neither available nor needed. A stack holds
rasters of falling resolution, each within the next; a point belongs to the finest that is over it. Tracing, lines of
sight, footprints and votes take a stack wherever they take a `Dem`.

Two surveys of the same ground differ by decimetres to tens of metres. A fine level is therefore fitted into the coarser
one, once, when a stack is made:

* **Holes** (NaN nodes, at the raster's margin too) take the coarser surface plus the difference of the two at the
  hole's rim: d = sum(d_k / r_k) / sum(1 / r_k) over the four directions along the grid, with d_k the difference at the
  first known node, or 0 at the raster's edge, and r_k its distance. This is the delta surface fill of Grohman, Kroenung
  and Strebeck (2006), Photogrammetric Engineering & Remote Sensing 72(3).
* **The border**: within `BAND` coarse cells the fine heights give way to the coarser surface in proportion to the
  distance from the edge. The small step that may remain between two fine nodes is a wall: no ray slips through."""

import math
import threading
from collections.abc import Callable, Hashable, Iterable, Sequence
from pathlib import Path
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.geodesy import SiteFrame, same_crs
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem, read_around
from ltm_core.raster.heights_check import HeightsDoubt, doubt_of_heights

_open: WeakValueDictionary[Hashable, Dem] = WeakValueDictionary()
_lock = threading.Lock()


def shared(paths: Iterable[Path | str], way: Hashable, read: Callable[[], Dem]) -> Dem:
    """Return the result of `read` for the files at `paths`, shared in this process while it is in use and no file has
    changed. `way`: all other inputs. A shared terrain must not be modified. Errors are those of `read`."""
    with _lock:
        try:
            key: Hashable = (way, *(_state(path) for path in paths))
        except OSError:
            return read()  # which says what is wrong with the file
        dem = _open.get(key)
        if dem is None:
            dem = _open[key] = read()
        return dem


def _state(path: Path | str) -> tuple[str, int, int, int]:
    found = Path(path).stat()
    return str(Path(path).resolve()), found.st_ino, found.st_size, found.st_mtime_ns


_ROUNDING = 1e-6  # cells
REACH = 40_000.0
"""Distance in metres around the finest raster to which coarser ones are read."""
BAND = 3.0
"""Width in coarse cells over which fine heights blend into coarse ones; at most a quarter of the raster."""
_SAMPLES = 200
"""Number of points per side at which two rasters' heights are compared."""


class DemStack(Dem):
    """Rasters in one CRS, finest first, each within the next but for a cell of that.

    It is a `Dem` whose `elevation` and `geometry` are its finest level's, and which goes on beyond that level's edge.
    The given levels are not changed. Raises RasterError: fewer than two levels, not in order of resolution, in
    different CRSs, or one that reaches beyond the next."""

    coarser: tuple[Dem, ...]
    """Coarser levels, finest first."""

    def __init__(
        self, levels: Sequence[Dem], doubts: tuple[HeightsDoubt, ...] = (), fitted: bool = False, own: bool = False
    ) -> None:
        """`fitted`: the levels are fitted to each other already. `own`: they may be written to; else they are
        copied."""
        if len(levels) < 2:
            raise RasterError(f"a stack needs a fine and at least one coarser raster, got {len(levels)}")
        levels = list(levels)
        for k in () if fitted else range(len(levels) - 2, -1, -1):
            fine, coarse = levels[k], levels[k + 1]
            levels[k] = fine = _within(fine if own else Dem(fine.elevation.copy(), fine.geometry), coarse)
            _fit(fine, coarse, with_holes=True)
        super().__init__(levels[0].elevation, levels[0].geometry, doubts)
        object.__setattr__(self, "coarser", tuple(levels[1:]))

    @classmethod
    def open(cls, path: Path | str, crs: str | None = None, *coarser: tuple[Path | str, str | None]) -> "DemStack":
        """Open the finest raster as `Dem.open` does, and around it, out to REACH, the (path, CRS or None) of coarser
        ones. These may be in another CRS, in degrees too: they are warped, bilinearly, to that of the finest.

        All levels must have the same vertical datum: correct a datum shift of more than a few metres beforehand
        (gdalwarp with vertical CRSs). Raises RasterError as `Dem.open` and the stack itself do."""
        finest = Dem.open(path, crs)
        x_min, y_min, x_max, y_max = finest.geometry.bounds
        around = x_min - REACH, y_min - REACH, x_max + REACH, y_max + REACH
        levels, doubts = [finest], list(finest.doubts)
        for place, stated in coarser:
            levels.append(Dem(*read_around(place, stated, str(finest.geometry.crs), around)))
            doubts += levels[-1].doubts
            own, other = (sampled(level, finest.geometry) for level in (finest, levels[-1]))
            doubt = doubt_of_heights(own, other, str(path), str(place))
            doubts += [] if doubt is None else [doubt.required()]
        return cls(levels, tuple(doubts), own=True)

    @property
    def levels(self) -> tuple[Dem, ...]:
        """Return all rasters, finest first."""
        return (Dem(self.elevation, self.geometry), *self.coarser)

    def in_frame(self, frame: SiteFrame) -> "DemStack":
        """Return the same stack in a site's map frame; see `Dem.in_frame`."""
        return DemStack([level.in_frame(frame) for level in self.levels], self.doubts, fitted=True)

    def elevation_at(self, x: ArrayLike, y: ArrayLike) -> Float64Array:
        """Return the bilinear height at map points of the finest level over them; NaN beyond the coarsest and in
        holes."""
        x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
        height = np.full(x.shape, np.nan)
        left = np.ones(x.shape, np.bool_)
        for level in self.levels:
            row, col = level.geometry.to_grid(x, y)
            here = left & (row >= 0) & (row <= level.geometry.height - 1)
            here &= (col >= 0) & (col <= level.geometry.width - 1)
            height[here] = level.elevation_at(x[here], y[here])
            left &= ~here
        return height


def open_terrain(rasters: Sequence[tuple[Path | str, str | None]]) -> Dem:
    """Open (path, CRS or None) of one raster as `Dem.open` does, of several, finest first, as `DemStack.open` does."""
    (path, crs), *coarser = rasters
    return DemStack.open(path, crs, *coarser) if coarser else Dem.open(path, crs)


def sampled(dem: Dem, over: GridGeometry) -> Float64Array:
    """Return the heights at points spread evenly over a raster."""
    rows, cols = (np.linspace(0, n - 1, min(n, _SAMPLES)) for n in over.shape)
    return dem.elevation_at(*over.to_map(rows[:, None], cols[None, :]))


def with_surface(ground: Dem, surface: Dem) -> Dem:
    """Return the terrain with the tops of trees and buildings where `surface` has them, and bare earth elsewhere.

    `surface` heights are elevations, as the ground's; where it is NaN, the ground shows. Raises RasterError as
    `DemStack` does."""
    tops = surface.elevation.copy()
    for row in np.flatnonzero([np.isnan(heights).any() for heights in tops]):
        cols = np.flatnonzero(np.isnan(tops[row]))
        tops[row, cols] = ground.elevation_at(*surface.geometry.to_map(row, cols))
    levels = [level for level in ground.levels if any(_excess(level.geometry, surface.geometry))]
    whole, doubts = Dem(tops, surface.geometry, ground.doubts + surface.doubts), ground.doubts + surface.doubts
    if not levels:
        return whole
    whole = _within(whole, levels[0])
    _fit(whole, levels[0], with_holes=False)
    return DemStack([whole, *levels], doubts, fitted=True)


def _excess(fine: GridGeometry, coarse: GridGeometry) -> tuple[int, int, int, int]:
    """Return how many of its rows and columns a raster has beyond another's outermost nodes: west, north, east,
    south."""
    x0, y0 = (float(v) for v in coarse.to_map(0, 0))
    x1, y1 = (float(v) for v in coarse.to_map(coarse.height - 1, coarse.width - 1))
    row0, col0 = (float(v) - _ROUNDING for v in fine.to_grid(x0, y0))
    row1, col1 = (float(v) + _ROUNDING for v in fine.to_grid(x1, y1))
    east, south = fine.width - 1 - math.floor(col1), fine.height - 1 - math.floor(row1)
    return max(0, math.ceil(col0)), max(0, math.ceil(row0)), max(0, east), max(0, south)


def _within(fine: Dem, coarse: Dem) -> Dem:
    """Return `fine` without the rows and columns that it has beyond the coarser level's outermost nodes.

    Raises RasterError where that is more than a coarse cell, or the two do not go together."""
    a, b = fine.geometry, coarse.geometry
    if not same_crs(a.crs, b.crs):
        raise RasterError(f"a stack's rasters must be in one CRS, got {a.crs} and {b.crs}")
    if a.resolution > b.resolution:
        raise RasterError(
            f"a stack's rasters go from fine to coarse, but one of {a.resolution:g} m comes before one of "
            f"{b.resolution:g} m"
        )
    west, north, east, south = _excess(a, b)
    most = math.ceil(b.resolution / a.resolution)
    if max(west, north, east, south) > most:
        raise RasterError(
            f"a raster of {a.resolution:g} m over {_rounded(a)} reaches beyond the coarser one of {b.resolution:g} m "
            f"over {_rounded(b)}: give a coarser one that surrounds it, or clip it (gdal_translate -projwin)"
        )
    if max(west, north, east, south) == 0:
        return fine
    inside = a.window(north, west, a.height - north - south, a.width - west - east)
    return Dem(fine.elevation[north : a.height - south, west : a.width - east].copy(), inside)


def _rounded(geometry: GridGeometry) -> tuple[int, ...]:
    return tuple(round(v) for v in geometry.bounds)


def _fit(fine: Dem, coarse: Dem, with_holes: bool) -> None:
    """Fill the holes of `fine` from `coarse`, where that is known, and lead its border over to it, in place."""
    from ltm_core.raster.dem_seam_kernels import blend, fill  # here, because most processes of a graph need no numba

    a, b = fine.geometry, coarse.geometry
    rows, _ = b.to_grid(b.x_min, a.to_map(np.arange(a.height), 0)[1])  # where the fine ones lie in the coarse raster
    _, cols = b.to_grid(a.to_map(0, np.arange(a.width))[0], b.y_max)
    if with_holes:
        fill(fine.elevation, coarse.elevation, rows, cols)
    band = min(BAND * b.resolution / a.resolution, (min(a.shape) - 1) / 4)
    blend(fine.elevation, coarse.elevation, rows, cols, band)
