import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes.outlets import Kept
from scenes.phone_site import FRAME, GROUND, LAT, LON, STAMP, phone_site, picture
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu, NavSatFix

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.cameras.sensor_pose import phone_camera
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, pose_covariance
from ltm_msgs_py.image import compressed_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import make_header
from ltm_ros.nodes.capture import CaptureConfig, CaptureHandler
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import FIX, IMU, POSE, POSED_IMAGE, POSED_POSE

S = 10**9
TRUE = {"north": "true"}
SEEN = (231.0, -4.0, 1.5)
"""Azimuth from true north, pitch, roll."""


def fix(stamp: int = STAMP, lon: float = LON, variances: tuple[float, ...] = (), **fields: Any) -> Any:
    message = NavSatFix(header=make_header(stamp, "gps"), latitude=LAT, longitude=lon, altitude=GROUND + 9.0 - 35.4)
    if variances:
        message.position_covariance = np.diag(variances).ravel()
        message.position_covariance_type = NavSatFix.COVARIANCE_TYPE_DIAGONAL_KNOWN
    for name, value in fields.items():
        setattr(message, name, value)
    return message


def imu(stamp: int, angles: tuple[float, float, float] = SEEN, mount: Float64Array | None = None) -> Any:
    """Of a phone whose camera looks so; landscape unless mounted otherwise."""
    device = Pose.from_angles((0.0, 0.0, 0.0), *angles).rotation @ (phone_camera(90.0) if mount is None else mount).T
    message = Imu(header=make_header(stamp, "phone"))
    q = message.orientation
    q.x, q.y, q.z, q.w = (float(v) for v in Rotation.from_matrix(device).as_quat())
    return message


def photo(stamp: int = STAMP, portrait: bool = False, raw: bool = False) -> Any:
    if raw:
        return image_to_msg(picture(portrait), "rgb8", stamp, "phone")
    return compressed_to_msg(encode_rgb(picture(portrait), "jpeg"), "jpeg", stamp, "phone")


def info(portrait: bool = False) -> Any:
    size = (40, 64) if portrait else (64, 40)
    return camera_to_msg(Camera(*size, 48.0, 48.0, (size[0] - 1) / 2, (size[1] - 1) / 2), STAMP, "phone")


def capture(
    tmp_path: Path, sensors: dict[str, Any], expert: dict[str, Any] | None = None, **camera: Any
) -> tuple[CaptureHandler, Kept, Health]:
    phone_site(tmp_path)
    document = yaml.safe_load((tmp_path / "site.yaml").read_text())
    document["cameras"] = {"phone": {"sensors": sensors, **camera}}
    document["expert"] = {"cameras": {"phone": {"sensors": expert or {}}}}
    (tmp_path / "site.yaml").write_text(yaml.safe_dump(document))
    outlet, health = Kept(), Health()
    outlet.now = STAMP + S
    return (
        CaptureHandler(CaptureConfig(site=str(tmp_path / "site.yaml"), camera="phone"), outlet, health),
        outlet,
        health,
    )


def sent(outlet: Kept) -> tuple[Pose, Float64Array]:
    (message,) = outlet.on(POSED_POSE)
    covariance = msg_to_covariance(message)
    assert covariance is not None
    return msg_to_pose(message, "map"), covariance


@pytest.mark.parametrize("raw", [False, True])
@pytest.mark.parametrize("portrait", [False, True])
def test_a_phones_image_is_posed_by_the_nearest_attitude_and_the_last_fix(
    tmp_path: Path, portrait: bool, raw: bool
) -> None:
    node, outlet, health = capture(tmp_path, TRUE, image="raw" if raw else "compressed")
    assert {FIX, IMU} <= node.subscriptions.keys()
    assert POSE not in node.subscriptions
    mount = phone_camera(0.0 if portrait else 90.0)
    node.on_camera_info(info(portrait))
    node.subscriptions[FIX](fix(STAMP - S))
    node.subscriptions[FIX](fix(STAMP - 5 * S, lon=LON + 0.01))
    node.subscriptions[IMU](imu(STAMP - S // 50, (200.0, 0.0, 0.0), mount))
    node.on_image(photo(STAMP, portrait, raw))
    assert outlet.on(POSED_IMAGE) == []  # a nearer attitude may be on its way
    node.subscriptions[IMU](imu(STAMP + S // 100, SEEN, mount))
    pose, covariance = sent(outlet)
    x, y = (float(v) for v in FRAME.from_lonlat(LON, LAT))
    np.testing.assert_allclose(pose.position, [x, y, GROUND + 1.6], atol=0.01)
    np.testing.assert_allclose(pose.angles_deg, [FRAME.true_to_grid_deg(231.0, x, y), -4.0, 1.5], atol=1e-6)
    np.testing.assert_allclose(covariance, pose_covariance(pose, 5.0, 1.0, 8.2, 1.0, 1.0), atol=1e-9)
    assert health.dropped == {}


def test_what_the_messages_state_of_their_errors_goes_on(tmp_path: Path) -> None:
    node, outlet, _ = capture(tmp_path, TRUE, {"geoid_undulation": -35.4})
    turn = imu(STAMP)
    turn.orientation_covariance = np.diag([0.0004, 0.0001, 0.01]).ravel()
    node.on_camera_info(info())
    node.subscriptions[FIX](fix(variances=(4.0, 6.0, 64.0)))
    node.subscriptions[IMU](turn)
    node.on_image(photo())
    pose, covariance = sent(outlet)
    assert pose.position[2] == pytest.approx(GROUND + 9.0)
    expected = pose_covariance(pose, math.sqrt(5.0), 8.0, math.degrees(0.1), math.degrees(0.02), math.degrees(0.02))
    np.testing.assert_allclose(covariance, expected, atol=1e-9)


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"latitude": math.nan}, "invalid GPS fix"),
        ({"latitude": 91.0}, "invalid GPS fix"),
        ({"latitude": 0.0, "longitude": 0.0}, r"\(0, 0\)"),
        (
            {"position_covariance_type": 2, "position_covariance": np.diag([1.0, -1.0, 1.0]).ravel()},
            "negative variances",
        ),
    ],
)
def test_fixes_that_are_none_are_refused(tmp_path: Path, fields: dict[str, Any], complaint: str) -> None:
    node, _, _ = capture(tmp_path, TRUE)
    with pytest.raises(PoseError, match=complaint):
        node.subscriptions[FIX](fix(**fields))
    lost = fix()
    lost.status.status = -1
    with pytest.raises(PoseError, match="no GPS fix"):
        node.subscriptions[FIX](lost)
