import math
from dataclasses import replace

import numpy as np
import pytest
from scenes.rasters import rough_terrain
from scipy.spatial.transform import Rotation

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.mount.mount_config import MountConfig, written_mount
from ltm_core.pose_estimation.mount.mount_model import MountModel
from ltm_core.raster.dem import Dem
from ltm_core.storage.config_io import checked

PLACE = (120.0, -340.0, 812.0)
FRAME = SiteFrame("EPSG:26911", 480_000.0, 4_150_000.0)


def head(azimuth: float, pitch: float = 0.0, roll: float = 0.0, tilt_zero: float = 0.0, **kind: object) -> MountModel:
    base = Pose.from_angles(PLACE, azimuth, pitch, roll)
    return replace(MountModel(base, math.radians(tilt_zero), np.zeros((7, 7))), **kind)  # type: ignore[arg-type]


def angles(model: MountModel, pan: float, tilt: float) -> tuple[float, float, float]:
    return model.pose(pan, tilt)[0].angles_deg


def test_an_upright_heads_angles_add_up() -> None:
    model = head(200.0, tilt_zero=0.5)
    assert angles(model, 0.0, 0.0) == pytest.approx((200.0, 0.5, 0.0))
    assert angles(model, 75.0, -12.0) == pytest.approx((275.0, -11.5, 0.0), abs=1e-9)
    assert angles(model, 300.0, 8.0) == pytest.approx((140.0, 8.5, 0.0), abs=1e-9)
    assert model.pose(75.0, -12.0)[0].position.tolist() == list(PLACE)


def test_axes_that_run_the_other_way() -> None:
    assert angles(head(200.0, pan_sign=-1), 75.0, 5.0) == pytest.approx((125.0, 5.0, 0.0), abs=1e-9)
    assert angles(head(200.0, tilt_sign=-1), 75.0, 5.0) == pytest.approx((275.0, -5.0, 0.0), abs=1e-9)


def test_a_mount_that_pitches_up_looks_down_behind_it_and_rolls_beside_it() -> None:
    model = head(30.0, pitch=2.0)
    assert angles(model, 0.0, 0.0) == pytest.approx((30.0, 2.0, 0.0), abs=1e-9)
    assert angles(model, 180.0, 0.0) == pytest.approx((210.0, -2.0, 0.0), abs=1e-9)
    # To the right, the ground behind the mount's back is lower on that side: the camera leans to its left.
    azimuth, pitch, roll = angles(model, 90.0, 0.0)
    assert (azimuth, pitch) == pytest.approx((120.0, 0.0), abs=1e-9)
    assert abs(roll) == pytest.approx(2.0, abs=1e-9)
    assert np.sign(roll) == -np.sign(angles(model, -90.0, 0.0)[2])


def _turn(a: Float64Array, b: Float64Array) -> Float64Array:
    """The rotation vector about the map's axes from a to b."""
    return np.asarray(Rotation.from_matrix(b @ a.T).as_rotvec(), np.float64)


def test_the_covariance_is_that_of_each_parameter_moved_by_itself() -> None:
    model = head(203.0, 0.8, -0.5, 0.3, pan_sign=-1)
    pan, tilt, step = 61.0, -9.0, 1e-6
    at = model.rotation(pan, tilt)
    turns = np.radians([0.1, 0.2, 0.4, 0.3])
    columns = [
        _turn(at, model.corrected(step * w, 0.0, np.zeros(3), model.covariance).rotation(pan, tilt)) for w in np.eye(3)
    ]
    columns.append(_turn(at, model.corrected(np.zeros(3), step, np.zeros(3), model.covariance).rotation(pan, tilt)))
    encoders = [
        _turn(at, model.rotation(pan + math.degrees(step), tilt)),
        _turn(at, model.rotation(pan, tilt + math.degrees(step))),
    ]
    expected = sum(np.outer(c, c) * s**2 for c, s in zip(columns, turns, strict=True)) / step**2
    expected = expected + sum(np.outer(c, c) for c in encoders) / step**2 * math.radians(0.03) ** 2
    known = replace(model, covariance=np.diag([0.1, 0.2, 0.3, *turns]) ** 2)
    found = known.pose(pan, tilt)[1]
    assert found[3:, 3:] == pytest.approx(expected, rel=1e-4, abs=1e-12)
    assert np.sqrt(np.diag(found)[:3]) == pytest.approx([0.1, 0.2, 0.3])


def _dem() -> Dem:
    return Dem(rough_terrain(7, (60, 80)).elevation, GridGeometry(0.0, 600.0, 10.0, 80, 60))


def test_what_is_written_is_the_model_again() -> None:
    rng = np.random.default_rng(4)
    half = rng.normal(size=(4, 4))
    model = replace(
        head(203.4, 0.8, -0.5, 0.3, tilt_sign=-1), base=Pose.from_angles((300.0, 200.0, 900.0), 203.4, 0.8, -0.5)
    )
    model = model.with_angle_covariance(half @ half.T * 1e-6)
    section = written_mount(model, None, FRAME)
    config = checked(MountConfig, section, "mount")
    assert config.calibrated
    again = config.model(_dem(), FRAME)
    assert again.base.position == pytest.approx(model.base.position, abs=1e-3)
    for pan in (0.0, 70.0, 250.0):
        pose, covariance = again.pose(pan, -4.0)
        expected, expected_covariance = model.pose(pan, -4.0)
        assert pose.rotation == pytest.approx(expected.rotation, abs=3e-6)
        assert covariance[3:, 3:] == pytest.approx(expected_covariance[3:, 3:], rel=2e-3, abs=1e-10)


def test_an_uncalibrated_mount_is_as_unsure_as_a_compass_and_a_level() -> None:
    config = MountConfig(x=480_300.0, y=4_150_200.0, height_above_ground=20.0, azimuth_deg=203.0)
    model = config.model(_dem(), FRAME)
    assert not config.calibrated
    assert np.degrees(np.sqrt(np.diag(model.angle_covariance))) == pytest.approx([1.5, 0.5, 0.5, 0.3], rel=1e-5)
    assert 1.4 < model.direction_sigma_deg(0.0) < 1.6


@pytest.mark.parametrize(
    ("section", "told"),
    [
        ({"covariance_deg2": [[1.0, 0.0], [0.0, 1.0]]}, "4 by 4"),
        ({"covariance_deg2": np.diag([1.0, 1.0, -1.0, 1.0]).tolist()}, "not a covariance"),
        ({"pan_sign": 0}, "pan_sign"),
        ({"yaw_deg": 3.0}, "yaw_deg: unknown key"),
    ],
)
def test_a_wrong_section_is_refused(section: dict[str, object], told: str) -> None:
    with pytest.raises(ConfigError, match=told):
        checked(MountConfig, {"x": 0.0, "y": 0.0, "z": 1.0, "azimuth_deg": 3.0, **section}, "site.yaml")
