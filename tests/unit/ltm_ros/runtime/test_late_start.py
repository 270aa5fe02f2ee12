from __future__ import annotations

import threading
from collections.abc import Callable

from ltm_core.base.errors import ConfigError
from ltm_ros.runtime.retry import LONGEST_PAUSE_S, Backoff, LateStart


class Disk:
    """Something is made of what is on it, once it is there. `tries` counts, by name."""

    def __init__(self) -> None:
        self.there: set[str] = set()
        self.tries: dict[str, int] = {}
        self.why = "no such file"

    def make(self, name: str) -> Callable[[], str]:
        def made() -> str:
            self.tries[name] = self.tries.get(name, 0) + 1
            if name not in self.there:
                raise ConfigError(f"{name}: {self.why}")
            return name.upper()

        return made


def _at_once(work: Callable[[], None]) -> None:
    work()


def test_each_is_made_once_its_files_are_there() -> None:
    disk, lines = Disk(), list[str]()
    late = LateStart({n: disk.make(n) for n in ("north", "south")}, {}, lines.append, _at_once)
    assert late.tick(0.5) == []
    assert disk.tries == {}
    for _ in range(10):
        assert late.tick(1.0) == []
    assert min(disk.tries.values()) > 1
    disk.there.add("south")
    made = [one for _ in range(60) for one in late.tick(1.0)]
    assert made == ["SOUTH"]
    assert lines[-1] == "south: started"
    disk.there.add("north")
    assert [one for _ in range(int(LONGEST_PAUSE_S) + 1) for one in late.tick(1.0)] == ["NORTH"]
    tries = dict(disk.tries)
    assert late.tick(10 * LONGEST_PAUSE_S) == []
    assert disk.tries == tries


def test_the_pause_doubles_up_to_its_limit_and_begins_anew_after_a_success() -> None:
    backoff = Backoff(1.0, 60.0)
    assert [backoff.failed() for _ in range(8)] == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0]
    for _ in range(2000):
        backoff.failed()
    assert backoff.pause_s == 60.0
    backoff.succeeded()
    assert backoff.failed() == 1.0


def test_a_bug_is_no_end_and_what_nobody_took_is_given_back_at_the_close() -> None:
    """On a thread: ticks go on while an attempt lasts, and begin no second one."""
    begun, go_on, tries = threading.Event(), threading.Event(), list[int]()

    def make() -> str:
        tries.append(1)
        if len(tries) == 1:
            raise ZeroDivisionError
        begun.set()
        assert go_on.wait(30)
        return "made"

    late = LateStart({"north": make}, {"north": "ZeroDivisionError()"}, lambda line: None)
    while not begun.wait(0.01):
        assert late.tick(1.0) == []
    for _ in range(10):
        assert late.tick(LONGEST_PAUSE_S) == []
    assert len(tries) == 2
    assert late.close(0.0) == []
    go_on.set()
    assert late.close(30.0) == ["made"]
    assert late.tick(LONGEST_PAUSE_S) == []
