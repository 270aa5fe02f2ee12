import math

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from ltm_core.base.errors import MessageError
from ltm_core.pose_estimation.mount.mount_model import PoseCorrection
from ltm_msgs_py.pose import correction_to_msg, correction_values, msgs_to_correction
from ltm_msgs_py.sensors import msg_to_fix, place_to_fix
from ltm_msgs_py.stamp import stamp_of
from ltm_msgs_py.status import LONGEST, MOST_VALUES, msg_to_values, status_to_msg

STAMP = 1_700_000_000_123_456_789


def test_values_are_text_with_a_stamp_and_a_level() -> None:
    values = {"ratio": 0.1, "ok": True, "none": None, "angles": [1.5, -2.0], "share": {"sky": 0.25, "far": {"n": 3}}}
    msg = status_to_msg("north/fused", STAMP, values, "too dark", wrong=True)
    assert stamp_of(msg) == STAMP
    (status,) = msg.status
    assert (status.name, status.message, status.level) == ("north/fused", "too dark", DiagnosticStatus.WARN)
    assert msg_to_values(msg) == {
        "ratio": "0.1",
        "ok": "true",
        "none": "",
        "angles": "1.5 -2.0",
        "share.sky": "0.25",
        "share.far.n": "3",
    }
    assert status_to_msg("a", 0, {}).status[0].level == DiagnosticStatus.OK


@pytest.mark.parametrize("values", [{"a": "x" * (LONGEST + 1)}, {str(n): "" for n in range(MOST_VALUES + 1)}])
def test_a_message_that_is_too_large_is_rejected(values: dict[str, str]) -> None:
    with pytest.raises(MessageError):
        msg_to_values(status_to_msg("a", 0, values))


def correction(angles: bool = True) -> PoseCorrection:
    covariance = np.array([[4.0, 0.5, 0.25], [0.5, 3.0, -0.125], [0.25, -0.125, 2.0]]) * 1e-6 if angles else None
    tilt = np.array([1e-7, -2e-7, 3e-7, 5e-7]) if angles else np.zeros(4)
    return PoseCorrection(np.array([0.01, -0.02, 0.03]), covariance, 0.0123456789012345, tilt)


@pytest.mark.parametrize("angles", [True, False])
def test_a_correction_with_its_tilt_zero_comes_back_from_two_messages(angles: bool) -> None:
    sent = correction(angles)
    rotation = correction_to_msg(sent, STAMP)
    assert (rotation.pose.pose.position.x, rotation.pose.covariance[0]) == (0.0, 0.0), "it moves nothing"
    found = msgs_to_correction(rotation, status_to_msg("north/pose", STAMP, correction_values(sent)))
    np.testing.assert_allclose(found.rotation, sent.rotation, rtol=1e-12)
    assert found.tilt_zero == sent.tilt_zero
    np.testing.assert_array_equal(found.tilt_covariance, sent.tilt_covariance)
    if sent.angles is None:
        assert found.angles is None
    else:
        np.testing.assert_allclose(found.angles, sent.angles, rtol=1e-12)


@pytest.mark.parametrize(
    "values",
    [{}, {"tilt_zero": "nan", "tilt_covariance": "0 0 0 0"}, {"tilt_zero": "0", "tilt_covariance": "0 0 0"},
     {"tilt_zero": "a", "tilt_covariance": "0 0 0 0"}],
)  # fmt: skip
def test_a_tilt_zero_that_is_no_number_is_rejected(values: dict[str, str]) -> None:
    with pytest.raises(MessageError, match="tilt_zero"):
        msgs_to_correction(correction_to_msg(correction(), STAMP), status_to_msg("north/pose", STAMP, values))


def test_a_place_is_a_fix_without_an_altitude() -> None:
    msg = place_to_fix(-117.25, 37.5, np.array([[9.0, 2.0], [2.0, 16.0]]), STAMP, "map")
    found = msg_to_fix(msg)
    assert (found.lon, found.lat, found.stamp_ns) == (-117.25, 37.5, STAMP)
    assert math.isnan(msg.altitude)
    np.testing.assert_array_equal(found.covariance[:2, :2], [[9.0, 2.0], [2.0, 16.0]])
