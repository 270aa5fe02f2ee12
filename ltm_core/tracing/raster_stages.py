"""Split the path of rays over a stack of DEM rasters into stages, one raster each, for the tracing kernels.

A single raster is one stage. In a stack each raster lies within the next coarser one, so a ray's way over raster k is
one interval, which contains that over raster k - 1: it goes from the raster that the camera stands over inwards to the
finest, and from there outwards to the coarsest, and in between leaves each one out. All rays take the same order."""

import threading
from weakref import WeakKeyDictionary

import numpy as np

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.raster.dem import Dem
from ltm_core.tracing.holes import filled_at, find_holes, in_outer_hole
from ltm_core.tracing.possible_ground import PossibleGround
from ltm_core.tracing.pyramid import build_pyramid
from ltm_core.tracing.pyramid_traversal import AFTER, BEFORE, WHOLE, CellWindow, RasterStage, TerrainRaster

Grounds = tuple[tuple[TerrainRaster, ...], float]
_known: WeakKeyDictionary[Dem, dict[PossibleGround, Grounds]] = WeakKeyDictionary()
_one_at_a_time = threading.Lock()


def grounds(dem: Dem, possible: PossibleGround) -> Grounds:
    """Return the kernels' data of each level, finest first, and of unknown ground, and the height in metres above which
    there is no ground outside the DEM; shared while the terrain is in use. Raises RasterError for infinite heights."""
    with _one_at_a_time:
        made = _known.setdefault(dem, {})
        if possible not in made:
            made[possible] = _grounds(dem, possible)
        return made[possible]


def _grounds(dem: Dem, possible: PossibleGround) -> Grounds:
    made: list[TerrainRaster] = []
    tops = [float(np.fmax.reduce(level.elevation, axis=None)) for level in dem.levels]
    top = highest = possible.limit(max(tops))
    for level, own in zip(reversed(dem.levels), reversed(tops), strict=True):
        elevation = level.elevation
        if (infinite := np.isinf(elevation)).any():
            row, col = divmod(int(infinite.argmax()), elevation.shape[1])
            raise RasterError(f"the DEM is infinite at row {row}, column {col}; mark unknown heights as nodata (NaN)")
        rise = possible.steepest * level.geometry.resolution
        holes = find_holes(elevation, rise, highest)
        pyramid = build_pyramid(elevation, holes)
        height, width = elevation.shape
        top = max(top, own)
        made.append(TerrainRaster(elevation.ravel(), holes, width, height, *pyramid, top))
    return tuple(reversed(made)), highest


def stages(
    dem: Dem, position: Float64Array, bend: float, steepest: float, highest: float
) -> list[tuple[int, RasterStage]]:
    """Return the levels and their stages in the order in which rays from `position` (3,) come to them; `bend` in 1/m.
    `steepest`, `highest`: of the ground that may lie beyond."""
    windows = [_window(level, position) for level in dem.levels]
    last = len(windows) - 1
    stands_on = next((k for k, w in enumerate(windows) if _is_inside(w)), last)

    def stage(k: int, part: int) -> tuple[int, RasterStage]:
        resolution = float(dem.levels[k].geometry.resolution)  # kernels are compiled for such
        own = finer = windows[k]
        if k > 0:
            scale = dem.levels[k - 1].geometry.resolution / resolution
            finer = CellWindow(*(edge * scale for edge in windows[k - 1]))
        ends = k == last and part != BEFORE
        ray = -own.west, -own.north, float(position[2]), resolution, bend * resolution**2
        return k, RasterStage(*ray, own, finer, part, ends, steepest * resolution, highest)

    inwards = [stage(k, BEFORE) for k in range(stands_on, 0, -1)]
    return [*inwards, stage(0, WHOLE), *(stage(k, AFTER) for k in range(1, last + 1))]


def filled_corners(dem: Dem, ground: TerrainRaster, position: Float64Array) -> Float32Array | None:
    """Return the heights of the four nodes around a position over one raster, with the ceilings of enclosed holes and
    NaN in outer ones; None where it is not over the raster."""
    if not _is_inside(_window(dem, position)):
        return None
    row, col = (float(v) for v in dem.geometry.to_grid(position[0], position[1]))
    at = min(int(row), ground.height - 2) * ground.width + min(int(col), ground.width - 2)
    nodes = (at, at + 1, at + ground.width, at + ground.width + 1)
    known = ground.nodes, ground.holes
    return np.array([np.nan if in_outer_hole(*known, n) else filled_at(*known, n) for n in nodes], np.float32)


def _window(dem: Dem, position: Float64Array) -> CellWindow:
    row, col = (float(v) for v in dem.geometry.to_grid(position[0], position[1]))
    height, width = dem.elevation.shape
    return CellWindow(0.0 - col, 0.0 - row, width - 1 - col, height - 1 - row)


def _is_inside(window: CellWindow) -> bool:
    return window.west <= 0.0 <= window.east and window.north <= 0.0 <= window.south
