import math

import numpy as np
import pytest
from scenes.located import CAMERA, hills, plain, sighting

from ltm_core.base.errors import PoseError, RegionError
from ltm_core.geometry.pose import Pose, pose_covariance
from ltm_core.locating.locator import Locator
from ltm_core.locating.region import marked_pixel
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import Sighting

pytestmark = pytest.mark.kernel

EXACT = LocatingConfig(dem_sigma=0.0, detection_range=1e6, focal_sigma=0.0)


def test_on_level_ground_the_ellipse_follows_from_the_formula() -> None:
    height, azimuth, pitch, dem_sigma = 300.0, 30.0, -9.0, 2.0
    pose = Pose.from_angles((0.0, 0.0, 50.0 + height), azimuth, pitch)
    covariance = pose_covariance(pose, 1.0, 1.5, 0.2, 0.1, 0.3)
    # In the middle of the picture roll does not matter.
    mark = marked_pixel(CAMERA, (CAMERA.cx, CAMERA.cy), 2.0)
    config = EXACT.model_copy(update={"dem_sigma": dem_sigma})
    posterior = Locator(plain(), 0.0, config).locate([Sighting("a", CAMERA, pose, covariance, mark)]).posterior
    slope = math.tan(math.radians(-pitch))
    r = height / slope
    per_slope = r / slope
    tilt = math.hypot(math.radians(0.1), 2.0 / CAMERA.fy) * (1 + slope**2)
    along = math.sqrt((per_slope * tilt) ** 2 + 1.0**2 + (1.5 / slope) ** 2 + (dem_sigma / slope) ** 2)
    across = math.sqrt((r * math.hypot(math.radians(0.2), 2.0 / CAMERA.fx / math.cos(math.radians(pitch)))) ** 2 + 1.0)
    azimuth_vector = np.array([math.sin(math.radians(azimuth)), math.cos(math.radians(azimuth))])
    assert np.array(posterior.mean) == pytest.approx(azimuth_vector * r, abs=0.1 * along)
    variances, axes = np.linalg.eigh(posterior.covariance)
    assert np.sqrt(variances[::-1]) == pytest.approx((along, across), rel=0.03)
    assert abs(axes[:, 1] @ azimuth_vector) == pytest.approx(1.0, abs=1e-3)
    ellipse = posterior.ellipse(0.95)
    assert (ellipse.major, ellipse.minor) == pytest.approx((2.4477 * along, 2.4477 * across), rel=0.05)


def test_smoke_from_behind_a_crest_may_stand_anywhere_there() -> None:
    dem = hills()
    locator = Locator(dem, 0.0, EXACT)
    tower = (0.0, 0.0, 130.0)
    # Where the line of sight over the first crest meets the second hill, ground is seen again.
    slope = (100 - 130) / 1000
    crest = np.array([30.0, 1000.0, 100.0])
    location = locator.locate([sighting("a", tower, crest, 0.02)], smoke=True)
    y = location.posterior.places[:, 1]
    behind = location.posterior.probability[(y > 1010) & (y < 2500)].sum()
    assert behind > 0.9
    assert location.posterior.densest(0.95).sum() > 50
    # Low plumes are likelier: behind the crest less hangs below the line of sight near it than at the far foot.
    lift = 130 + slope * y - dem.elevation_at(*location.posterior.places.T)
    expected = float(location.posterior.probability @ np.clip(lift, 0, None))
    assert location.lift == pytest.approx(expected, abs=6.0)
    # What is marked as standing on the ground before the crest stands there.
    before = locator.locate([sighting("a", tower, np.array([30.0, 940.0, 70.0]), 0.02)]).posterior
    assert before.mean == pytest.approx((30.0, 940.0), abs=10.0)
    assert before.ellipse(0.95).major < 60


def test_a_second_camera_decides_where_behind_the_crest() -> None:
    dem = hills()
    locator = Locator(dem, 0.0, EXACT)
    foot = np.array([30.0, 1700.0, 0.0])
    hidden = sighting("a", (0.0, 0.0, 130.0), np.array([30.0 * 1000 / 1700, 1000.0, 100.0]), 0.05)
    seen = sighting("b", (1100.0, 1500.0, 80.0), foot, 0.05)
    alone = locator.locate([hidden], smoke=True).posterior
    both = locator.locate([hidden, seen], smoke=True)
    assert both.agreement is not None
    assert both.agreement.agree
    assert both.posterior.mean == pytest.approx((30.0, 1700.0), abs=10.0)
    assert both.posterior.sigma < 0.1 * alone.sigma


def test_two_from_one_direction_stay_long() -> None:
    place = np.array([400.0, 2500.0, 50.0])
    config = LocatingConfig(dem_sigma=8.0)
    locator = Locator(plain(), 0.0, config)
    a, b = sighting("a", (0.0, 0.0, 200.0), place, 0.01), sighting("b", (5.0, 3.0, 200.0), place, 0.01)
    one, two = locator.locate([a]).posterior.ellipse(0.95), locator.locate([a, b]).posterior.ellipse(0.95)
    # The terrain's error is most of it, and theirs in common.
    assert two.major > 0.9 * one.major
    assert two.azimuth_deg == pytest.approx(one.azimuth_deg, abs=2.0)


@pytest.mark.parametrize("turned", [0, 1])
def test_the_camera_that_is_turned_is_the_most_suspicious(turned: int) -> None:
    dem = hills()
    place = np.array([-100.0, 2480.0, float(dem.elevation_at(-100.0, 2480.0))])
    towers = [(-900.0, 1300.0, 180.0), (200.0, 1250.0, 160.0), (1200.0, 1700.0, 190.0)]
    sightings = [
        sighting(f"camera_{k}", tower, place, 0.05, turned_deg=2.0 if k == turned else 0.0)
        for k, tower in enumerate(towers)
    ]
    location = Locator(dem, 0.0).locate(sightings)
    assert location.agreement is not None
    suspicion = location.agreement.suspicion
    assert max(suspicion, key=suspicion.__getitem__) == f"camera_{turned}"
    assert location.agreement.statistic > location.agreement.limit
    assert location.posterior.mean == pytest.approx(tuple(place[:2]), abs=15.0)


def test_of_two_that_disagree_both_places_stay() -> None:
    dem = hills()
    place, other = np.array([-100.0, 2480.0, 64.0]), np.array([60.0, 2500.0, 80.0])
    sightings = [
        sighting("a", (-900.0, 1300.0, 180.0), place, 0.05),
        sighting("b", (1200.0, 1700.0, 190.0), other, 0.05),
    ]
    location = Locator(dem, 0.0).locate(sightings)
    assert location.agreement is not None
    assert not location.agreement.agree
    assert sum(location.agreement.suspicion.values()) == pytest.approx(1)
    assert len(location.posterior.modes) >= 2


def test_what_cannot_be_located_is_told() -> None:
    dem = hills()
    locator = Locator(dem, 0.0)
    tower = (0.0, 0.0, 130.0)
    with pytest.raises(RegionError, match=r"sky: it is .* degrees above"):
        locator.locate([sighting("a", tower, np.array([0.0, 2000.0, 500.0]))])
    with pytest.raises(RegionError, match="clear of the ground"):
        locator.locate([sighting("a", tower, np.array([0.0, 2000.0, 500.0]))], smoke=True)
    with pytest.raises(RegionError, match="no known terrain"):
        locator.locate([sighting("a", (0.0, 4200.0, 130.0), np.array([0.0, 9000.0, 0.0]))])
    with pytest.raises(PoseError, match=r"10\.00 m under the ground"):
        locator.locate([sighting("a", (0.0, 1000.0, 90.0), np.array([0.0, 2400.0, 0.0]))])
    with pytest.raises(RegionError, match="1 to 64"):
        locator.locate([])
    good = sighting("a", tower, np.array([0.0, 900.0, 50.0]))
    with pytest.raises(PoseError, match="covariance"):
        locator.locate([Sighting("a", good.camera, good.pose, np.full((6, 6), np.nan), good.mark)])
    with pytest.raises(RegionError, match=r"sigma of 57\.\d degrees"):
        locator.locate([Sighting("a", good.camera, good.pose, np.eye(6), good.mark)])
    down = Pose.from_angles(tower, 10.0, -89.0)
    with pytest.raises(RegionError, match="degrees from the horizon"):
        locator.locate([Sighting("a", CAMERA, down, good.covariance, marked_pixel(CAMERA, (900.0, 500.0), 2.0))])
