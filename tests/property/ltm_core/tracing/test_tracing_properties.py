"""What must hold on any terrain, for any ray."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scenes.examples import examples

from ltm_core.base.types import Float64Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer

pytestmark = pytest.mark.kernel

ROWS, COLS = 7, 12
heights = st.floats(0, 40, width=32)
terrains = arrays(np.float32, (ROWS, COLS), elements=heights)
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
