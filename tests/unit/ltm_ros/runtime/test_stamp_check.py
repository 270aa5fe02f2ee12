from __future__ import annotations

import pytest

from ltm_ros.runtime.health import Health
from ltm_ros.runtime.stamp_check import StampCheck

NOW = 1_800_000_000 * 10**9
S = 10**9
DAY = 86_400 * S


def check_at(now: int) -> tuple[StampCheck, Health]:
    health = Health()
    return StampCheck(lambda: now, health, 10.0, 7 * 86400.0), health


@pytest.mark.parametrize(
    ("now", "stamp", "cause"),
    [
        (NOW, NOW, ""),
        (NOW, NOW + 9 * S, ""),
        (NOW, NOW + 11 * S, "future"),
        (NOW, NOW - 6 * DAY, ""),
        (NOW, NOW - 8 * DAY, "past"),
        (NOW, 5 * S, "unset_clock"),
        (0, 5 * S, "unset_clock"),
        (0, NOW, ""),
        (100 * S, 95 * S, ""),  # a simulation's clock
        (100 * S, NOW, "future"),  # this machine's clock was never set
    ],
)
def test_what_is_refused(now: int, stamp: int, cause: str) -> None:
    check, health = check_at(now)
    assert check.refuses("an image", stamp) is bool(cause)
    assert health.dropped == ({cause: 1} if cause else {})
    assert ("an image" in health.last_error) is bool(cause)


def test_a_jump_of_a_source_is_noted_once_and_is_its_own() -> None:
    now = NOW
    health = Health()
    check = StampCheck(lambda: now, health, 10.0, 7 * 86400.0)

    def jumps() -> str:
        return health.summary().get("noted.stamp_jump", "0")

    for minute in range(5):
        now = NOW + minute * 60 * S
        for camera in ("north", "south"):
            assert not check.refuses(camera, now - 3 * S)
    assert jumps() == "0"
    assert not check.refuses("north", now - 3600 * S), "its clock was set back by an hour"
    assert jumps() == "1"
    now += 60 * S
    assert not check.refuses("north", now - 3600 * S)
    assert not check.refuses("south", now - 3 * S)
    assert jumps() == "1"
