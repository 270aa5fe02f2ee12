import numpy as np
import pytest

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.pipeline.frame_steps import UnlikelyLabels
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import PossibleGround
from ltm_core.vision.label_rules import less_likely
from ltm_core.vision.labels import Label

CAMERA, POSE = Camera.from_fov(960, 540, 60.0), Pose.from_angles((600.0, 100.0, 20.0), 0.0, 0.0)


@pytest.fixture
def terrain() -> UnlikelyLabels:
    """A plain up to 400 m before the camera, then a slope of 30 degrees, whose crest is at 14.8 degrees."""
    north = np.broadcast_to(895.0 - 10.0 * np.arange(90)[:, None], (90, 120))
    heights = np.maximum(north - 500.0, 0) * np.tan(np.radians(30))
    dem = Dem(heights.astype(np.float32), GridGeometry(0.0, 900.0, 10.0, 120, 90))
    return UnlikelyLabels(TerrainTracer(dem, possible=PossibleGround(highest=0.0)))


def at(mask: np.ndarray, elevation_deg: float) -> bool:
    """Return the value in the middle column at an angle above the horizon."""
    rows, cols = mask.shape
    focal = cols / 2 / np.tan(np.radians(30))
    return bool(mask[round((rows - 1) / 2 - focal * np.tan(np.radians(elevation_deg))), cols // 2])


def test_sky_on_ground_and_water_on_slopes_are_unlikely(terrain: UnlikelyLabels) -> None:
    found = terrain.of(CAMERA, POSE, None)
    sky = {angle: at(found[Label.SKY], angle) for angle in (17.0, 13.2, 5.0, -10.0)}
    assert sky == {17.0: False, 13.2: True, 5.0: True, -10.0: True}
    water = {angle: at(found[Label.WATER], angle) for angle in (17.0, 5.0, -10.0)}
    assert water == {17.0: False, 5.0: True, -10.0: False}


@pytest.mark.parametrize(
    ("place", "angle_deg", "near_the_crest"), [(0.1, 0.01, True), (0.1, 0.8, False), (15, 0, False)]
)
def test_errors_of_the_pose_leave_a_margin(
    terrain: UnlikelyLabels, place: float, angle_deg: float, near_the_crest: bool
) -> None:
    covariance = np.diag([place**2] * 3 + [np.radians(angle_deg) ** 2] * 3)
    sky = terrain.of(CAMERA, POSE, covariance)[Label.SKY]
    assert at(sky, 13.2) == near_the_crest
    assert at(sky, 2.0)


def test_a_pose_in_doubt_or_under_ground_says_nothing(terrain: UnlikelyLabels) -> None:
    assert terrain.of(CAMERA, POSE, np.diag([0.0] * 5 + [np.radians(1.1) ** 2])) == {}
    assert terrain.of(CAMERA, Pose.from_angles((600.0, 700.0, 20.0), 0.0), None) == {}


def test_odds_fall_by_a_bounded_factor_and_other_pixels_stay() -> None:
    planes = np.array([[[0.9, 0.99, 0.6]], [[0.1, 0.01, 0.4]]], np.float32)
    expected = planes[:, :, 2].copy()
    less_likely(planes, 0, np.array([[True, True, False]]))
    np.testing.assert_allclose(planes[0, 0, :2] / planes[1, 0, :2], np.array([9.0, 99.0]) * np.exp(-3), rtol=1e-5)
    assert planes[:, 0].argmax(axis=0).tolist() == [1, 0, 0]
    np.testing.assert_array_equal(planes[:, :, 2], expected)
