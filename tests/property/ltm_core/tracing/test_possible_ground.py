"""Unknown ground: both ways of tracing and the reference agree, and no ground within its bounds changes an answer."""

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scenes.examples import examples
from scenes.traced_terrain import assert_same

from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import PossibleGround
from ltm_lab.tracers.reference import trace_reference, with_ceilings

ROWS, COLS = 19, 26
RESOLUTION = 2.0
AROUND = 40
"""Cells beyond the raster, over which possible ground rises as high as it gets."""
STEPS_OVER_STRAIGHT = 1.0824
"""A way of straight and diagonal steps is that much longer than the straight line, at most: ground that rises with the
steps is that much steeper."""
CAMERA = Camera.from_fov(24, 17, 75.0)
bounds = st.builds(
    PossibleGround,
    steepest=st.floats(0.2, 3.0),
    highest=st.none() | st.floats(0.0, 90.0),
    margin=st.just(0.0) | st.floats(0.0, 20.0),
)
places = st.tuples(st.floats(1.0, COLS - 2.1), st.floats(1.0, ROWS - 2.1), st.floats(0.05, 30.0)).map(
    lambda place: (place[0] + 0.0137, place[1] + 0.0239, place[2] + 0.0071)
)
"""Column, row, height above the ground; off all round numbers, from which rays meet the ground on the very last line of
nodes of the raster: whether that is over it or beyond it is rounding's affair."""
angles = st.tuples(st.floats(0, 360), st.floats(-60, 30), st.floats(-30, 30))


@st.composite
def surveys(draw: st.DrawFn) -> Dem:
    """A survey with a ragged outline, concave where it likes, and holes in it."""
    rough = draw(arrays(np.float32, (ROWS, COLS), elements=st.floats(0, 12, width=32)))
    tilt = draw(st.floats(-1.0, 1.0))
    heights = rough + np.float32(tilt) * np.arange(COLS, dtype=np.float32) + np.float32(30.0)
    outline = draw(st.lists(st.integers(0, 9), min_size=ROWS, max_size=ROWS))
    for row, bite in enumerate(outline):
        heights[row, COLS - bite :] = np.nan
    for row, col in draw(st.lists(st.tuples(st.integers(0, ROWS - 1), st.integers(0, COLS - 1)), max_size=25)):
        heights[row, col] = np.nan
    return Dem(heights, GridGeometry(0.0, ROWS * RESOLUTION, RESOLUTION, COLS, ROWS))


def pose_over(dem: Dem, place: tuple[float, float, float], looks: tuple[float, float, float]) -> Pose:
    """A camera over known ground."""
    x, y = (float(v) for v in dem.geometry.to_map(place[1], place[0]))
    ground = float(dem.elevation_at(x, y))
    assume(np.isfinite(ground))
    return Pose.from_angles((x, y, ground + place[2]), *looks)


def directions(pose: Pose) -> Float64Array:
    return np.asarray(CAMERA.rays().reshape(-1, 3) @ pose.rotation.T)


@examples(16, in_fuzz=60)
@given(surveys(), bounds, places, angles)
def test_every_way_agrees_with_the_reference(
    dem: Dem, possible: PossibleGround, place: tuple[float, float, float], looks: tuple[float, float, float]
) -> None:
    pose = pose_over(dem, place, looks)
    tracer = TerrainTracer(dem, possible=possible)
    slow = trace_reference(dem, pose.position, directions(pose), tracer.bend, possible)
    for way in ("profile", "pyramid"):
        assert_same(tracer.trace(CAMERA, pose, way).range, slow, (way, pose.position, possible))


@examples(16, in_fuzz=60)
@given(surveys(), bounds, places, angles)
def test_a_camera_beyond_the_edge_sees_in(
    dem: Dem, possible: PossibleGround, place: tuple[float, float, float], looks: tuple[float, float, float]
) -> None:
    x, y = (float(v) for v in dem.geometry.to_map(place[1], COLS - 1 + place[0] / 4))
    assume(np.isnan(dem.elevation_at(x, y)))
    pose = Pose.from_angles((x, y, 35.0 + place[2]), *looks)
    tracer = TerrainTracer(dem, possible=possible)
    slow = trace_reference(dem, pose.position, directions(pose), tracer.bend, possible)
    assert_same(tracer.trace(CAMERA, pose, "pyramid").range, slow, (pose.position, possible))


@examples(16, in_fuzz=60)
@given(surveys(), bounds, places, angles, st.floats(0.0, 1.0))
def test_no_possible_ground_changes_an_answer(
    dem: Dem,
    possible: PossibleGround,
    place: tuple[float, float, float],
    looks: tuple[float, float, float],
    share: float,
) -> None:
    """Put ground into the holes and around the raster that is as high as it may be, or lower: hits stay, sky stays."""
    pose = pose_over(dem, place, looks)
    found = TerrainTracer(dem, curvature=False, possible=possible).trace(CAMERA, pose).range
    around = np.pad(dem.elevation, AROUND, constant_values=np.nan)
    known = np.isfinite(around)
    highest = possible.limit(float(np.nanmax(dem.elevation)))
    rise = possible.steepest * RESOLUTION
    inner, _ = with_ceilings(dem.elevation, rise, highest)
    # The raster's own border, known or possible, is what the ground beyond rises from.
    around[AROUND:-AROUND, AROUND:-AROUND] = inner
    outer, _ = with_ceilings(around, rise / STEPS_OVER_STRAIGHT, highest)
    filled = np.where(known, outer, share * outer + (1 - share) * np.float32(-50.0)).astype(np.float32)
    geometry = GridGeometry(
        -AROUND * RESOLUTION, (ROWS + AROUND) * RESOLUTION, RESOLUTION, COLS + 2 * AROUND, ROWS + 2 * AROUND
    )
    ground = Dem(filled, geometry)
    truth = TerrainTracer(ground, curvature=False, possible=possible).trace(CAMERA, pose).range
    hit = np.isfinite(found)
    np.testing.assert_allclose(found[hit], truth[hit], rtol=1e-4, atol=1e-3)
    assert not np.isfinite(truth[np.isposinf(found)]).any()
