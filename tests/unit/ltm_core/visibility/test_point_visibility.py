import numpy as np
import pytest
from scenes.rasters import RIDGE_X, RIDGE_Z, ridge, rough_terrain, standing

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.visibility.point_visibility import PointState, PointVisibility

pytestmark = pytest.mark.kernel

CAMERA = Camera(160, 120, 150.0, 150.0, 79.0, 60.0, (-0.08, 0.0, 0.0, 0.0, 0.0))


def test_behind_a_ridge_the_lift_follows_from_its_crest() -> None:
    scene = ridge()
    origin = np.array([-390.0, 10.0, float(scene.dem.elevation_at(-390.0, 10.0)) + 2.0])
    sight = PointVisibility(scene.dem, curvature=False)
    points = np.array([[300.0, 10.0, 40.0], [500.0, 10.0, 40.0], [-100.0, 10.0, 220.0]])
    lift, unknown = sight.lifts(origin, points)
    # Foot and crest: the whole rise lies below the line from the camera over the crest.
    slope = (RIDGE_Z[1] - origin[2]) / (RIDGE_X[1] - origin[0])
    assert lift[:2] == pytest.approx(origin[2] + slope * (points[:2, 0] - origin[0]) - 40.0, abs=1e-3)
    assert lift[2] == pytest.approx(0.0, abs=1e-4)
    assert not unknown.any()


def test_curvature_hides_what_lies_beyond_the_horizon() -> None:
    dem = Dem(np.full((60, 500), 50.0, np.float32), GridGeometry(0.0, 6000.0, 100.0, 500, 60))
    origin = np.array([1000.0, 3000.0, 70.0])
    points = np.array([[1000.0 + r, 3000.0, 50.0] for r in (5000.0, 15_000.0, 30_000.0, 40_000.0)])
    sight = PointVisibility(dem)
    lift, _ = sight.lifts(origin, points)
    horizon = np.sqrt(20.0 / sight.bend)
    assert 15_000 < horizon < 18_000
    # Behind the horizon a point must reach the line that touches the plain there.
    expected = [0.0, 0.0, sight.bend * (30_000 - horizon) ** 2, sight.bend * (40_000 - horizon) ** 2]
    assert lift == pytest.approx(expected, abs=1e-3)
    assert not PointVisibility(dem, curvature=False).lifts(origin, points)[0].any()


def test_traced_points_are_visible_at_their_pixels() -> None:
    dem = rough_terrain(5, (181, 263))
    pose = Pose.from_angles(standing(dem, 100.0, 60.0, 12.0), 80.0, -12.0, 5.0)
    traced = TerrainTracer(dem).trace(CAMERA, pose)
    seen = np.isfinite(traced.range)
    assert seen.mean() > 0.5
    result = PointVisibility(dem).visible(CAMERA, pose, traced.points()[seen], tolerance=0.02)
    assert result.visible.all()
    rows, cols = np.nonzero(seen)
    assert np.abs(result.pixels - np.column_stack([cols, rows])).max() < 0.02


def test_states() -> None:
    scene = ridge()
    pose = Pose.from_angles((-390.0, 10.0, 140.0), 90.0)
    points = np.array(
        [
            [-100.0, 10.0, 220.0],  # on the near slope
            [300.0, 10.0, 40.0],  # in the valley behind the crest
            [-395.0, 10.0, 102.0],  # behind the camera
            [-390.0, 200.0, 150.0],  # at its side
            [5000.0, 10.0, 2026.0],  # in the air far beyond the DEM
            [-389.0, 10.0, 90.0],  # below the ground, at the foot of the mast
        ]
    )
    result = PointVisibility(scene.dem).visible(CAMERA, pose, points)
    expected = ["VISIBLE", "HIDDEN", "OUTSIDE", "OUTSIDE", "UNKNOWN", "OUTSIDE"]
    assert [PointState(s).name for s in result.states] == expected
    assert np.isnan(result.pixels[2]).all()
    assert result.visible.tolist() == [True, False, False, False, False, False]


def test_a_hole_on_the_way_leaves_it_unknown() -> None:
    elevation = np.full((41, 83), 100.0, np.float32)
    elevation[18:23, 40:44] = np.nan
    elevation[17, 41] = 130.0  # at the hole's rim
    dem = Dem(elevation, GridGeometry(0.0, 0.0, 1.0, 83, 41))
    x, y = dem.geometry.to_map([20.0, 20.0, 5.0], [70.0, 30.0, 70.0])
    places = np.column_stack([x, y, [100.0, 100.0, 100.0]])
    # Within the hole, four cells wide, the ground may be 3 m higher than around it, not as high as the node at its rim.
    lift, unknown = PointVisibility(dem).lifts(standing(dem, 20.0, 10.0, 3.0), places)
    assert unknown.tolist() == [True, False, False]
    assert 1.0 < lift[0] < 10.0
    _, unknown = PointVisibility(dem).lifts(standing(dem, 20.0, 10.0, 20.0), places)
    assert not unknown.any(), "the line of sight clears all that the hole may hold"
