from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo

from ltm_core.base.errors import CameraError
from ltm_core.geometry.camera import Camera
from ltm_msgs_py.sensors import camera_to_msg, msg_to_camera

CAMERA = Camera(1920, 1080, 1550.25, 1549.5, 961.0, 538.75, (-0.1155, 0.02, 1e-4, -2e-4, 0.003))


def info() -> CameraInfo:
    return camera_to_msg(CAMERA, 3_000_000_004, "east_optical")


def test_the_message_says_plumb_bob_at_full_resolution() -> None:
    msg = info()
    assert (msg.width, msg.height, msg.distortion_model) == (1920, 1080, "plumb_bob")
    assert list(msg.d) == list(CAMERA.distortion)
    np.testing.assert_array_equal(msg.k, [1550.25, 0, 961.0, 0, 1549.5, 538.75, 0, 0, 1])
    np.testing.assert_array_equal(msg.p, [1550.25, 0, 961.0, 0, 0, 1549.5, 538.75, 0, 0, 0, 1, 0])
    np.testing.assert_array_equal(msg.r, np.eye(3).ravel())
    assert (msg.header.stamp.sec, msg.header.stamp.nanosec, msg.header.frame_id) == (3, 4, "east_optical")


@pytest.mark.parametrize(
    ("d", "expected"),
    [
        ([], (0, 0, 0, 0, 0)),
        ([0.1, -0.2, 0.01, 0.02], (0.1, -0.2, 0.01, 0.02, 0)),
        ([0.1, -0.2, 0.01, 0.02, 0.3], (0.1, -0.2, 0.01, 0.02, 0.3)),
    ],
)
def test_distortion_of_0_4_or_5_numbers_is_taken(d: list[float], expected: tuple[float, ...]) -> None:
    msg = info()
    msg.d = d
    assert msg_to_camera(msg).distortion == expected


def _set(name: str, value: Any) -> Callable[[CameraInfo], None]:
    return lambda msg: setattr(msg, name, value)


def _k(index: int, value: float) -> Callable[[CameraInfo], None]:
    def change(msg: CameraInfo) -> None:
        k = np.array(msg.k)
        k[index] = value
        msg.k = k

    return change


def _roi(msg: CameraInfo) -> None:
    msg.roi.x_offset, msg.roi.width, msg.roi.height = 100, 800, 600


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (_k(0, 0.0), "uncalibrated"),
        (_k(0, np.nan), "finite"),
        (_k(5, np.inf), "finite"),
        (_k(0, -1550.0), "fx=-1550"),
        (_k(1, 0.5), "skew"),
        (_k(8, 2.0), "skew"),
        (_set("distortion_model", "rational_polynomial"), "'rational_polynomial'"),
        (_set("distortion_model", "equidistant"), "'equidistant'"),
        (_set("distortion_model", ""), "''"),
        (_set("d", [0.1, 0.2, 0.3]), "got 3"),
        (_set("d", [0.1] * 8), "got 8"),
        (_set("d", [0.1, np.nan, 0.0, 0.0, 0.0]), "nan"),
        (_set("width", 0), "0 x 1080"),
        (_set("height", 0), "1920 x 0"),
        (_set("binning_x", 2), "binning 2"),
        (_roi, "100, 0, 800, 600"),
    ],
)
def test_calibrations_that_cannot_be_taken_are_refused_by_value_and_frame(
    change: Callable[[CameraInfo], None], complaint: str
) -> None:
    msg = info()
    change(msg)
    with pytest.raises(CameraError, match=complaint) as caught:
        msg_to_camera(msg)
    assert "east_optical" in str(caught.value)
