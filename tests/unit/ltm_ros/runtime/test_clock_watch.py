"""ClockWatch: a clock that is set is noticed, one that drifts is not."""

from __future__ import annotations

from ltm_ros.runtime.clocks import ClockWatch

S = 10**9


class Clocks:
    def __init__(self) -> None:
        self.wall, self.elapsed, self.pause = 1_800_000_000 * S, 5 * S, 0

    def go_on(self, seconds: float) -> None:
        self.wall += round(seconds * S)
        self.elapsed += round(seconds * S)

    def wall_ns(self) -> int:
        self.elapsed += self.pause
        return self.wall

    def watch(self) -> ClockWatch:
        return ClockWatch(self.wall_ns, lambda: self.elapsed)


def test_steps_are_told_once_with_their_sign() -> None:
    clocks = Clocks()
    watch = clocks.watch()
    for step in (0.0, 3600.0, 0.0, -7.5, 0.0):
        clocks.go_on(0.5)
        clocks.wall += round(step * S)
        assert watch.step_s() == step


def test_slewing_is_no_step_but_many_small_ones_are() -> None:
    clocks = Clocks()
    watch = clocks.watch()
    told = []
    for _ in range(15):
        clocks.go_on(0.5)
        clocks.wall += S // 10
        told.append(watch.step_s())
    assert sum(told) == 1.0
    assert sum(step != 0 for step in told) == 1


def test_a_process_that_lay_still_sees_no_step() -> None:
    """Between the looks at the two clocks it got no core for a while."""
    clocks = Clocks()
    watch = clocks.watch()
    clocks.go_on(0.5)
    clocks.pause = 3 * S
    assert watch.step_s() == 0.0
    clocks.pause = 0
    clocks.wall += 3 * S
    assert watch.step_s() == 0.0


def test_this_machine_has_both_clocks() -> None:
    assert ClockWatch().step_s() == 0.0
