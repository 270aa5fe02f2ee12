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
