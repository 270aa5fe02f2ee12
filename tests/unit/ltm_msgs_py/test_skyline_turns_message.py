"""A picture's turns over the wire and back; what is none is refused."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from std_msgs.msg import String

from ltm_core.base.errors import MessageError
from ltm_core.pose_estimation.mount.skyline_turns import SKYLINE_TURNS, SkylineTurns
from ltm_msgs_py.skyline_turns import ToldTurns, msg_to_turns, turns_to_msg

LOGS = np.linspace(3.0, 120.0, len(SKYLINE_TURNS))
TOLD = ToldTurns(
    "north", np.radians([0.1, -0.2, 1.5]), SkylineTurns(1_700_000_000_123_456_789, math.radians(300.0), 1.1, LOGS)
)


def test_there_and_back() -> None:
    back = msg_to_turns(turns_to_msg(TOLD), "north")
    assert (back.camera, back.turns.stamp_ns) == ("north", TOLD.turns.stamp_ns)
    assert back.turns.azimuth == pytest.approx(TOLD.turns.azimuth, abs=1e-5)
    assert back.turns.hfov == pytest.approx(1.1, abs=1e-5)
    np.testing.assert_allclose(back.rotation, TOLD.rotation, atol=1e-5)
    np.testing.assert_allclose(back.turns.logs, LOGS, atol=1e-3)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"log_likelihood": [0.0] * 100}, "log_likelihood"),
        ({"log_likelihood": [1e9] * 101}, "log_likelihood"),
        ({"hfov_deg": 0.0}, "hfov_deg"),
        ({"rotation_deg": [0.0, 1e300, 0.0]}, "rotation_deg"),  # of which a sine is no number
        ({"stamp_ns": -1}, "stamp_ns"),
        ({"camera": "south"}, "of camera 'south'"),
        ({"step_deg": 0.2}, "steps of 0.2 deg"),
        ({"more": 1}, "more"),
    ],
)
def test_what_is_none_is_refused(change: dict[str, Any], said: str) -> None:
    content = json.loads(turns_to_msg(TOLD).data) | change
    with pytest.raises(MessageError, match=said):
        msg_to_turns(String(data=json.dumps(content)), "north")


@pytest.mark.parametrize("text", ["", "[]", "{", '{"camera": NaN}', "9" * 20_000])
def test_other_text_is_refused(text: str) -> None:
    with pytest.raises(MessageError):
        msg_to_turns(String(data=text), "north")
