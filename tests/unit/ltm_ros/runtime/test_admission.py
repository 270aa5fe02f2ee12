from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from ltm_core.base.errors import ImageError
from ltm_ros.runtime.admission import Admission
from ltm_ros.runtime.health import Health


@dataclass
class Door:
    """An admission of frames that are their own stamps; each holds ten bytes."""

    shed: bool = True
    workers: set[str] = field(default_factory=lambda: {"fuse", "vote"})
    heard: bool = True
    """Whether each worker has finished a frame before."""
    broken: set[int] = field(default_factory=set)
    """Frames that turn out to be none when they are let in."""
    view_of: Callable[[int], Hashable] = lambda _: None

    def __post_init__(self) -> None:
        self.health, self.admitted = Health(), list[int]()
        self.admission = Admission[int](
            self._admit, lambda: self.workers, self.health, 2, 10.0, self.shed, lambda _: 10, 50, view_of=self.view_of
        )
        if self.heard:
            self.finished(0, *self.workers)

    def offer(self, *stamps: int) -> None:
        for stamp in stamps:
            self.admission.offer(stamp, stamp)

    def finished(self, stamp: int, *workers: str) -> None:
        for worker in workers:
            self.admission.finished(worker, stamp)

    def stated(self, *keys: str) -> list[int]:
        summary = self.health.summary()
        return [int(summary.get(key, "0")) for key in keys]

    def _admit(self, frame: int) -> None:
        if frame in self.broken:
            raise ImageError(f"frame {frame}")
        self.admitted.append(frame)


def test_the_newest_waits_until_all_have_finished_a_frame() -> None:
    door = Door()
    door.offer(1, 2, 3, 4, 5)
    assert door.admitted == [1, 2]
    assert door.health.dropped == {"shed": 2}
    assert "frame of stamp 4 ns: a newer one is queued, and 2 are in flight (at fuse, vote)" in door.health.last_error
    door.finished(1, "vote")
    assert door.admitted == [1, 2]
    door.finished(1, "fuse")
    assert door.admitted == [1, 2, 5], "the newest was not lost, though no other came after it"
    assert door.stated("in_flight", "waiting", "finished") == [2, 0, 1]


def test_a_recording_waits_in_order_and_comes_through_whole() -> None:
    door = Door(shed=False)
    door.offer(1, 2, 3, 5, 4)
    for stamp in (1, 2, 3, 5, 4):
        door.finished(stamp, "fuse", "vote")
    assert door.admitted == [1, 2, 3, 5, 4]
    assert door.health.dropped == {}
    assert door.stated("finished", "in_flight") == [5, 0]


def test_what_waits_is_bounded_in_bytes() -> None:
    door = Door(shed=False)
    door.offer(*range(1, 10))
    assert door.stated("waiting", "dropped.shed") == [5, 2]
    door.finished(1, "fuse", "vote")
    assert door.admitted == [1, 2, 5], "the oldest went"


def test_a_worker_that_hangs_holds_the_camera_up_for_so_long_and_counts_again_when_it_is_back() -> None:
    door = Door()
    door.offer(1, 2)
    door.finished(1, "vote")
    door.finished(2, "vote")
    for second in range(10):
        door.admission.tick(1.0)
        door.offer(10 + second)
    assert door.admitted == [1, 2]
    door.admission.tick(1.0)
    assert door.admitted == [1, 2, 19]
    assert "fuse did not finish the frame of stamp 1 ns, nor any other, within 10 s" in door.health.last_error
    # The others set the pace now.
    door.offer(20, 21)
    assert door.admitted == [1, 2, 19, 20]
    door.finished(19, "vote")
    assert door.admitted == [1, 2, 19, 20, 21]
    # It is back, with a frame of long ago: what comes from now on waits for it again.
    door.finished(2, "fuse")
    door.finished(21, "vote")
    door.offer(30, 31, 32)
    door.finished(31, "vote")
    assert door.admitted[-2:] == [30, 31]
    door.finished(30, "fuse")
    assert door.admitted[-1] == 32


def test_of_a_patrol_the_view_that_was_let_in_longest_ago_comes_first() -> None:
    """Four views in turn, of which every second finds room: the newest alone would always be of the same two."""
    door = Door(workers={"fuse"}, view_of=lambda stamp: stamp % 4)
    door.offer(0, 1)
    for finished, stamp in enumerate(range(2, 82, 2)):
        door.offer(stamp, stamp + 1)
        door.finished(door.admitted[finished], "fuse")
    assert len(door.admitted) == 42
    counts = Counter(stamp % 4 for stamp in door.admitted)
    assert min(counts.values()) >= 10
    assert all(new > old for old, new in pairwise(door.admitted[::4]))


STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("offer"), st.integers(0, 200)),
        st.tuples(st.sampled_from(["fuse", "vote"]), st.integers(0, 200)),
        st.tuples(st.just("tick"), st.integers(0, 12)),
        st.tuples(st.sampled_from(["come fuse", "go fuse", "go vote"]), st.just(0)),
    ),
    max_size=60,
)


@given(STEPS, st.booleans())
def test_every_frame_is_in_flight_waits_or_is_counted(steps: list[tuple[str, int]], shed: bool) -> None:
    door = Door(shed=shed)
    offered: set[int] = set()
    unlimited = 0
    for what, number in steps:
        before = len(door.admitted)
        if what == "offer" and number not in offered:
            offered.add(number)
            door.offer(number)
        elif what in ("fuse", "vote"):
            door.finished(number, what)
        elif what == "tick":
            door.admission.tick(float(number))
        elif what.startswith("come"):
            door.workers.add("fuse")
        else:
            door.workers.discard(what.removeprefix("go "))
        keys = ("in_flight", "waiting", "finished", "noted.unfinished", "dropped.shed")
        in_flight, waiting, finished, unfinished, turned_away = door.stated(*keys)
        unlimited = len(door.admitted) - in_flight - finished - unfinished
        assert len(door.admitted) >= before
        assert len(offered) == len(door.admitted) + waiting + turned_away
        assert in_flight <= 2
        assert waiting <= (1 if shed else 5)
        assert unlimited >= 0
    door.admission.tick(11.0)
    door.admission.tick(11.0)
    assert door.stated("waiting", "in_flight")[0] == 0, "whatever happens, the newest is let in within the time"
