"""What must hold on any terrain, for any ray."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scenes.examples import examples

from ltm_core.base.types import Float64Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_lab.tracers.reference import trace_reference

pytestmark = pytest.mark.kernel

ROWS, COLS = 7, 12
heights = st.floats(0, 40, width=32)
terrains = arrays(np.float32, (ROWS, COLS), elements=heights)
holed = arrays(np.float32, (ROWS, COLS), elements=st.one_of(heights, heights, heights, st.just(float("nan"))))
positions = st.tuples(st.floats(0.5, COLS - 0.5), st.floats(0.5, ROWS - 0.5), st.floats(0.01, 30))
headings = st.floats(0, 360)
slopes = st.floats(-3, 1)


def dem_of(elevation: np.ndarray) -> Dem:
    return Dem(elevation, GridGeometry(0.0, float(ROWS), 1.0, COLS, ROWS))


def above(dem: Dem, position: tuple[float, float, float]) -> Float64Array:
    x, y, height = position
    return np.array([x, y, float(dem.elevation_at(x, y)) + height])


def ray(heading_deg: float, slope: float) -> Float64Array:
    direction = np.array([[np.sin(np.radians(heading_deg)), np.cos(np.radians(heading_deg)), slope]])
    return direction / np.linalg.norm(direction)


@examples(60, in_fuzz=150)
@given(terrains, positions, headings, slopes)
def test_a_hit_is_the_first_point_on_the_surface(
    elevation: np.ndarray, position: tuple[float, float, float], heading: float, slope: float
) -> None:
    dem = dem_of(elevation)
    origin, direction = above(dem, position), ray(heading, slope)
    length = float(TerrainTracer(dem, curvature=False).trace_rays(origin, direction)[0])
    path = origin + np.linspace(0, min(length, 40.0), 200)[:, None] * direction
    clearance = path[:, 2] - dem.elevation_at(path[:, 0], path[:, 1])
    steepest = 40 * 2 + abs(slope)
    if np.isfinite(length):
        assert abs(clearance[-1]) < 1e-4 + steepest * 1e-5
    known = clearance[:-1][np.isfinite(clearance[:-1])]
    assert (known > -1e-4 - steepest * 1e-5).all()


@examples(50, in_fuzz=100)
@given(terrains, positions, headings, slopes, st.integers(0, ROWS - 1), st.integers(0, COLS - 1), st.floats(0, 20))
def test_raising_terrain_never_lengthens_a_range(
    elevation: np.ndarray,
    position: tuple[float, float, float],
    heading: float,
    slope: float,
    row: int,
    col: int,
    rise: float,
) -> None:
    low = dem_of(elevation)
    raised = elevation.copy()
    raised[row, col] += np.float32(rise)
    high = dem_of(raised)
    origin = above(high, position)
    before, after = (float(TerrainTracer(d).trace_rays(origin, ray(heading, slope))[0]) for d in (low, high))
    if np.isfinite(before):
        assert after <= before * (1 + 1e-6) + 1e-6
    else:  # higher ground in the DEM, and there may be higher ground beyond it
        assert not (np.isnan(before) and np.isposinf(after))


@examples(60, in_fuzz=150)
@given(holed, positions, headings, slopes)
def test_holes_make_ranges_unknown_but_never_wrong(
    elevation: np.ndarray, position: tuple[float, float, float], heading: float, slope: float
) -> None:
    elevation[-1, -1] = 1.0
    dem, whole = dem_of(elevation), dem_of(np.nan_to_num(elevation, nan=-10.0))
    x, y, height = position
    assume(np.isfinite(dem.elevation_at(x, y)))
    origin, direction = above(dem, (x, y, height)), ray(heading, slope)
    tracer = TerrainTracer(dem)
    fast = float(tracer.trace_rays(origin, direction)[0])
    slow = float(trace_reference(dem, origin, direction, tracer.bend)[0])
    assert np.isnan(fast) == np.isnan(slow)
    assert np.isinf(fast) == np.isinf(slow)
    if np.isfinite(slow):
        assert abs(fast - slow) < 1e-4
        # Low ground put into the holes may shorten a range, not lengthen it.
        filled = float(TerrainTracer(whole).trace_rays(origin, direction)[0])
        assert filled <= fast + 1e-4


@examples(50, in_fuzz=100)
@given(terrains, positions, headings, slopes)
def test_mirrored_terrain_gives_the_same_range(
    elevation: np.ndarray, position: tuple[float, float, float], heading: float, slope: float
) -> None:
    dem, mirrored = dem_of(elevation), dem_of(np.ascontiguousarray(elevation[:, ::-1]))
    origin = above(dem, position)
    turned = origin * [-1, 1, 1] + [COLS, 0, 0]
    direct = float(TerrainTracer(dem).trace_rays(origin, ray(heading, slope))[0])
    reflected = float(TerrainTracer(mirrored).trace_rays(turned, ray(heading, slope) * [-1, 1, 1])[0])
    if np.isfinite(direct) and np.isfinite(reflected):
        assert abs(direct - reflected) < 1e-3 * max(1.0, direct) or abs(slope) < 1e-9
    else:
        np.testing.assert_equal(reflected, direct)
