from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scenes.kernel_counts import compiled
from scenes.rasters import rough_terrain, tilted_plane

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND, PossibleGround

pytestmark = pytest.mark.kernel

CAMERA = Camera(width=161, height=97, fx=120.0, fy=124.0, cx=77.0, cy=50.5, distortion=(-0.12, 0.03, 1e-3, -5e-4, 0.0))
MILLIMETRE = 1e-3


def assert_ranges(actual: np.ndarray, expected: Float64Array) -> None:
    """Equal kinds (sky, unknown), and ranges within 1 mm + float32 rounding."""
    np.testing.assert_array_equal(np.isposinf(actual), np.isposinf(expected))
    np.testing.assert_array_equal(np.isnan(actual), np.isnan(expected))
    hit = np.isfinite(expected)
    error = np.abs(actual[hit].astype(np.float64) - expected[hit])
    assert (error <= MILLIMETRE + np.spacing(expected[hit].astype(np.float32))).all(), f"off by up to {error.max()} m"


def first_positive_root(a: Float64Array, b: Float64Array, c: Float64Array) -> Float64Array:
    """Least r > 0 with a r^2 + b r + c = 0, where c > 0; +inf where there is none."""
    with np.errstate(invalid="ignore", divide="ignore"):
        discriminant = b * b - 4 * a * c
        root = 2 * c / (-b + np.sqrt(discriminant))
    return np.where(np.isfinite(root) & (root > 0), root, np.inf)


@pytest.mark.parametrize("curvature", [False, True])
@pytest.mark.parametrize(("azimuth_deg", "pitch_deg", "roll_deg"), [(70, -10, 3), (200, -35, -12), (325, -80, 45)])
def test_tilted_plane(curvature: bool, azimuth_deg: float, pitch_deg: float, roll_deg: float) -> None:
    scene = tilted_plane()
    pose = Pose.from_angles((-12.3, 7.9, 420 - 3 + 40.0), azimuth_deg, pitch_deg, roll_deg)
    traced = TerrainTracer(scene.dem, curvature, possible=NOTHING_BEYOND).trace(CAMERA, pose)

    ray = CAMERA.rays() @ pose.rotation.T
    across = np.hypot(ray[..., 0], ray[..., 1])
    east, north, slope = ray[..., 0] / across, ray[..., 1] / across, ray[..., 2] / across
    x, y, z = pose.position
    above = z - float(scene.surface(np.array(x), np.array(y)))
    r = first_positive_root(
        np.full(across.shape, ray_bend(curvature, 0.13)),
        slope - 0.31 * east + 0.17 * north,
        np.full(across.shape, above),
    )
    # Beyond the outermost cell centres nothing is known: rays that leave descending are unknown, the others sky.
    with np.errstate(invalid="ignore"):
        inside = (x + r * east > -299) & (x + r * east < 299) & (y + r * north > -211) & (y + r * north < 211)
    rim = np.minimum((np.copysign(299, east) - x) / east, (np.copysign(211, north) - y) / north)
    beyond = np.where(slope + 2 * ray_bend(curvature, 0.13) * rim >= 0, np.inf, np.nan)
    expected = np.where(inside, r / across, beyond)
    assert np.isfinite(expected).mean() > 0.2
    assert_ranges(traced.range, expected)


def test_curvature_and_refraction_lower_the_far_ground() -> None:
    flat = Dem(np.full((40, 500), 100.0, np.float32), GridGeometry(0.0, 4000.0, 100.0, 500, 40))
    slope = -0.004
    ray = [(1.0, 0.0, slope)]
    traced = [
        float(TerrainTracer(flat, *how).trace_rays((1000.0, 2000.0, 150.0), ray)[0])
        for how in [(False,), (True, 0.0), (True, 0.13)]
    ]
    radius = 6_371_008.8
    assert traced[0] == pytest.approx(50 / -slope * np.hypot(1, slope), rel=1e-6)
    for length, k in zip(traced[1:], (0.0, 0.13), strict=True):
        r = length / np.hypot(1, slope)
        assert 50 + slope * r + (1 - k) * r * r / (2 * radius) == pytest.approx(0.0, abs=0.01)
    assert traced[0] < traced[2] < traced[1]


def test_straight_down_and_straight_up() -> None:
    dem = rough_terrain(13)
    origin = np.array([100.3, -60.7, 1000.0])
    ground = float(dem.elevation_at(origin[0], origin[1]))
    tracer = TerrainTracer(dem)
    down, up, almost = tracer.trace_rays(origin, [(0, 0, -1), (0, 0, 2), (1e-7, -1e-7, -1)])
    assert down == pytest.approx(1000 - ground, abs=1e-3)
    assert np.isposinf(up)
    assert almost == pytest.approx(1000 - ground, abs=1e-3)

    nadir = tracer.trace(CAMERA, Pose.from_angles(origin, 20.0, -90.0, 0.0))
    u, v = (round(c) for c in (CAMERA.cx, CAMERA.cy))
    assert nadir.range[v, u] == pytest.approx(1000 - ground, rel=0.01)
    outside = tracer.trace_rays((-50.0, -60.0, 1000.0), [(0, 0, -1), (0, 0, 1)])
    assert np.isnan(outside[0])
    assert np.isposinf(outside[1])


def with_nodata(box: tuple[slice, slice]) -> Dem:
    """A level plain at 50 m, 60 x 100 cells of 1 m, higher (80 m) east of column 80, with nodata in `box`."""
    z = np.full((60, 100), 50.0, np.float32)
    z[:, 80:] = 80.0
    z[box] = np.nan
    return Dem(z, GridGeometry(0.0, 60.0, 1.0, 100, 60))


LAKE = (slice(20, 40), slice(40, 60))


def test_an_enclosed_hole_blocks_only_below_its_rim() -> None:
    tracer = TerrainTracer(with_nodata(LAKE), curvature=False)
    origin = (10.5, 29.5, 60.0)
    before, into, over, climbing_over = tracer.trace_rays(
        origin, [(1, 0, -0.5), (1, 0, -0.25), (1, 0, -0.05), (1, 0, 0.001)]
    )
    assert before == pytest.approx(20 * np.hypot(1, 0.5), rel=1e-5)
    assert np.isnan(into)
    # 60 - 0.05 * 50 = 57.5 m at the lake's far shore, above its rim; then it meets the step at column 79 to 80.
    assert over == pytest.approx((69 + (57 - 0.45 - 50) / 30) * np.hypot(1, 0.05), rel=1e-3)
    assert np.isfinite(climbing_over)


def plateau(edge: float) -> Dem:
    """100 x 60 m: 50 m high, with a tower of 80 m in the north-west, behind a camera, and `edge` in the east."""
    z = np.full((60, 100), 50.0, np.float32)
    z[2:5, 2:5] = 80.0
    z[:, 95:] = edge
    return Dem(z, GridGeometry(0.0, 60.0, 1.0, 100, 60))


@pytest.mark.parametrize(("highest", "rise"), [(None, 28.0), (120.0, 68.0)])
def test_sky_is_above_all_that_may_lie_beyond_the_end(highest: float | None, rise: float) -> None:
    """The raster ends 89 m from the camera, `rise` metres below the highest possible ground."""
    possible = PossibleGround(steepest=1.0, highest=highest, margin=0.0)
    tracer = TerrainTracer(plateau(50.0), curvature=False, possible=possible)
    slope = rise / 89
    below, above, down, steep = tracer.trace_rays(
        (10.5, 29.5, 52.0), [(1, 0, slope - 1e-3), (1, 0, slope + 1e-3), (1, 0, -0.01), (-1, 0, 1.01)]
    )
    assert np.isnan(below)
    assert np.isposinf(above)
    assert np.isnan(down)
    assert np.isposinf(steep)  # no ground ahead climbs like that


def test_a_camera_in_a_lake_below_its_rim_is_refused() -> None:
    tracer = TerrainTracer(with_nodata(LAKE))
    with pytest.raises(PoseError, match=r"nodata hole of the DEM, 2\.00 m below"):
        tracer.trace(CAMERA, Pose.from_angles((50.0, 30.0, 48.0), 90, 0, 0))
    assert np.isfinite(tracer.trace(CAMERA, Pose.from_angles((50.0, 30.0, 55.0), 90, 0, 0)).range).any()


def test_refuses_a_camera_under_the_ground_and_says_by_how_much() -> None:
    scene = tilted_plane(east=0.0, north=0.0, base=100.0)
    tracer = TerrainTracer(scene.dem)
    pose = Pose.from_angles((10.0, 20.0, 87.25), 0, 0, 0)
    with pytest.raises(PoseError, match=r"12\.75 m under the ground.* 100\.00 m"):
        tracer.trace(CAMERA, pose)


def test_the_smallest_dem() -> None:
    z = np.array([[10, 20, 30], [10, 20, 30]], np.float32)
    before: dict[str, int] = {}
    for place in (GridGeometry(0.0, 20.0, 10.0, 3, 2), GridGeometry(0, 20, 10, 3, 2)):
        tracer = TerrainTracer(Dem(z, place), curvature=False)
        (hit,) = tracer.trace_rays((6.0, 10.0, 25.0), [(1, 0, 0)])
        assert hit == pytest.approx(14.0, abs=1e-4)
        before = before or compiled()
    assert compiled() == before, "whole metres have kernels of their own"


def test_threads_may_trace_at_once() -> None:
    dem = rough_terrain(14)
    tracer = TerrainTracer(dem)
    pose = Pose.from_angles((100.0, -80.0, 900.0), 10, -20, 0)
    alone = tracer.trace(CAMERA, pose).range
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda _: tracer.trace(CAMERA, pose).range, range(12)))
    for ranges in together:
        np.testing.assert_array_equal(ranges, alone)
