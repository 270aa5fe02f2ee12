import numpy as np
import pytest
from scenes.located import hills, sighting

from ltm_core.geometry.pose import Pose
from ltm_core.locating.locator import Locator
from ltm_core.locating.tracks import KnownPoses, SeenAt, Tracks

pytestmark = pytest.mark.kernel

FIRE, OTHER = np.array([-100.0, 2480.0, 64.0]), np.array([900.0, 2500.0, 80.0])
TOWERS = {"a": (-900.0, 1300.0, 180.0), "b": (200.0, 1250.0, 160.0), "c": (1200.0, 1700.0, 190.0)}
MINUTE = 60_000_000_000


def seen(camera: str, place: np.ndarray, minute: int, turned_deg: float = 0.0) -> SeenAt:
    return SeenAt(sighting(camera, TOWERS[camera], place, 0.05, turned_deg), minute * MINUTE, "detector")


def test_sightings_of_one_fire_make_one_track_and_others_another() -> None:
    tracks = Tracks(Locator(hills(), 0.0))
    first, alone = tracks.add(seen("a", FIRE, 0))
    again, _ = tracks.add(seen("a", FIRE, 1))
    crossed, _ = tracks.add(seen("c", FIRE, 2))
    other, _ = tracks.add(seen("b", OTHER, 3))
    assert first is again is crossed
    assert first.cameras == ["a", "c"]
    assert first.location.posterior.sigma < alone.posterior.sigma
    assert first.location.posterior.mean == pytest.approx(tuple(FIRE[:2]), abs=20)
    assert other.number == 2
    assert (first.first_ns, first.last_ns) == (0, 2 * MINUTE)


def test_a_turned_camera_is_disputed_and_does_not_move_the_track() -> None:
    tracks = Tracks(Locator(hills(), 0.0))
    tracks.add(seen("a", FIRE, 0))
    fire, _ = tracks.add(seen("b", FIRE, 1))
    before = fire.location.posterior.mean
    turned, _ = tracks.add(seen("c", FIRE, 2, turned_deg=2.0))
    assert turned is not fire
    assert turned.disputed == fire.disputed == {"a", "b", "c"}
    assert fire.location.posterior.mean == before
    other, _ = tracks.add(seen("b", OTHER, 3))
    assert not other.disputed


def pose(azimuth_deg: float) -> Pose:
    return Pose.from_angles((10.0, 20.0, 30.0), azimuth_deg, -5.0)


def azimuth(found: tuple[Pose, object] | tuple[Pose, object, int] | None) -> float:
    assert found is not None
    return round(found[0].angles_deg[0], 6)


def known(stamps: range) -> KnownPoses:
    """The azimuth in degrees is a hundredth of the stamp."""
    poses = KnownPoses()
    for stamp in stamps:
        poses.add(stamp, pose(stamp / 100), np.eye(6) * stamp)
    return poses


def test_the_pose_of_the_stamp_itself_or_the_last_before_it() -> None:
    poses = known(range(1000, 2000, 100))
    assert azimuth(poses.at(1300, 0)) == 13.0
    assert azimuth(poses.at(1399, 99)) == 13.0
    assert poses.at(1399, 98) is None
    assert poses.at(999, 10_000) is None
