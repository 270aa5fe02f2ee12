import json

import pytest

from ltm_core.site.sections import WatchdogConfig
from ltm_ros.launching.watchdog import HangWatch

LIMITS = WatchdogConfig(silent=20.0, stuck=60.0, slow=300.0)
IDLE = "S", 0.0
WELL: list[tuple[float, bool, str]] = [(0.0, False, "executor: callback")]


def beat(turns: object) -> bytes:
    return json.dumps({"activities": turns, "ready": []}).encode() + b"\n"


class Watched:
    """A process that is looked at once a second."""

    def __init__(self, slow_starts: int = 0) -> None:
        self.watch = HangWatch(LIMITS, slow_starts)

    def hang(self, seconds: int, heard: bytes = b"", use: tuple[str, float] = IDLE) -> tuple[int, str]:
        """After how many seconds it was taken for hung, and why; `seconds` and nothing where it was not."""
        for second in range(1, seconds + 1):
            if found := self.watch.look(1.0, heard, use):
                return second, found
        return seconds, ""


def test_a_silent_process_hangs_and_one_that_is_stopped_is_said_to_be() -> None:
    watched = Watched()
    assert watched.hang(1000, beat(WELL)) == (1000, "")
    assert watched.hang(1000) == (21, "no heartbeat for 21 s")
    watched.watch.look(1.0, beat(WELL), IDLE)
    assert watched.hang(1000, use=("T", 0.0))[1].endswith("it is stopped (SIGSTOP)")


@pytest.mark.parametrize("state", ["R", "D"])
def test_what_waits_for_a_core_or_a_disk_has_as_long_as_a_message(state: str) -> None:
    """A machine that is busy, or whose disk stands still for a while, is not helped by another start."""
    watched = Watched()
    watched.watch.look(1.0, beat(WELL), IDLE)
    assert watched.hang(1000, use=(state, 0.0)) == (
        61,
        "no heartbeat for 61 s, although it is computing or waiting for a core",
    )


def test_a_worker_that_stands_is_seen_though_the_process_lives() -> None:
    def at_work(age: float, slow: bool = False) -> bytes:
        return beat([(0.0, False, "executor: callback"), (age, slow, "depth worker: CameraInfo")])

    watch = HangWatch(LIMITS)
    assert watch.look(1.0, at_work(60.0), IDLE) == ""
    assert watch.look(1.0, at_work(61.0), IDLE) == "depth worker: CameraInfo has not finished in 61 s"
    assert watch.look(1.0, at_work(61.0, slow=True), IDLE) == "", "what may take long"
    assert "in 301 s" in watch.look(1.0, at_work(301.0, slow=True), IDLE)
    assert "in 61 s" in HangWatch(LIMITS).look(1.0, beat([(61.0, False, "depth: callback")]), IDLE)


def test_nobody_is_judged_for_the_time_in_which_the_watch_lay_still() -> None:
    watch = HangWatch(LIMITS)
    watch.look(1.0, beat(WELL), IDLE)
    # Others had to wait for the runner, and say so.
    blocked = beat([(3000.0, False, "depth worker: CameraInfo")])
    assert watch.look(3600.0, blocked, IDLE) == ""
    assert watch.look(1.0, blocked, IDLE) == ""
    assert watch.look(1.0, beat(WELL), IDLE) == ""
    for _ in range(10):
        watch.look(1.0, blocked, IDLE)
    assert "3000 s" in watch.look(1.0, blocked, IDLE)
