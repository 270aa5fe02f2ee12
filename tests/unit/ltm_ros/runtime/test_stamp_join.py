from itertools import permutations
from types import SimpleNamespace
from typing import Any

import pytest
from scenes.outlets import Kept

from ltm_core.base.errors import MessageError
from ltm_msgs_py.stamp import make_header, stamp_of
from ltm_ros.runtime.handler import NodeConfig, Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.stamp_join import JoiningHandler, Match, Part, StampJoin


@pytest.fixture
def health() -> Health:
    return Health()


def join_of(health: Health, names: tuple[str, ...] = ("a", "b", "c"), capacity: int = 3) -> tuple[StampJoin, list[Any]]:
    done: list[Any] = []
    return StampJoin(names, lambda **parts: done.append(parts), health, capacity), done


def test_any_order_of_parts_makes_a_set(health: Health) -> None:
    join, done = join_of(health)
    for stamp, order in enumerate(permutations("abc")):
        for name in order:
            assert len(done) == stamp
            join.add(name, stamp, f"{name}{stamp}")
        assert done[-1] == {name: f"{name}{stamp}" for name in "abc"}
    join.finish()
    assert health.dropped == {}


def test_oldest_incomplete_set_goes_when_too_many_wait(health: Health) -> None:
    join, done = join_of(health, capacity=3)
    for stamp in (1, 2, 3):
        join.add("a", stamp, stamp)
    assert health.dropped == {}
    join.add("a", 4, 4)
    assert health.dropped == {"unjoined": 1}
    assert health.last_error == "unjoined: stamp 1 ns is incomplete, without b, c (3 later ones are queued)"
    for name in "bc":
        join.add(name, 2, name)
    assert done == [{"a": 2, "b": "b", "c": "c"}]
    join.finish()
    assert health.dropped == {"unjoined": 3}


def test_frames_go_on_without_what_they_can_do_without_when_they_have_waited(health: Health) -> None:
    done: list[Any] = []
    parts = ("a", Part("labels", wait_s=2.0, remembered=2))
    join = StampJoin(parts, lambda **found: done.append(found), health, capacity=3, whole_capacity=2)
    join.add("labels", 1, "first")  # before its frame
    join.add("a", 1, "a1")
    assert done.pop() == {"a": "a1", "labels": "first"}
    for stamp in (2, 3):
        join.add("a", stamp, f"a{stamp}")
    join.add("labels", 3, "third")
    assert done.pop() == {"a": "a3", "labels": "third"}
    join.tick(2.0)
    assert not done
    join.tick(0.5)
    assert done.pop() == {"a": "a2", "labels": None}
    for stamp in (4, 5, 6):  # more than two that wait for labels alone
        join.add("a", stamp, f"a{stamp}")
    assert done.pop() == {"a": "a4", "labels": None}
    join.finish()
    assert [found["a"] for found in done] == ["a5", "a6"]
    assert health.dropped == {}


def test_no_join_waits_for_ever_and_what_a_camera_lacked_is_counted(health: Health) -> None:
    join = StampJoin(("depth", "labels"), lambda **_: None, health, camera="north")
    join.add("labels", 7, "labels")
    join.tick(60.0)
    assert health.dropped == {}
    join.tick(0.5)
    assert health.dropped == {"unjoined": 1}
    assert health.summary()["noted.unjoined.north.depth"] == "1"
    assert health.last_error == "unjoined: north: stamp 7 ns is incomplete, without depth (waited 60 s)"


def test_a_pose_may_be_near_and_a_calibration_of_before(health: Health) -> None:
    done: list[Any] = []
    parts = ("image", Part("pose", Match.NEAREST, tolerance_ns=10), Part("info", Match.LATEST))
    join = StampJoin(parts, lambda **found: done.append(found), health)
    join.add("image", 100, "photo")
    join.add("info", 250, "later")
    join.add("pose", 95, "near")
    assert not done, "a nearer pose may still come"
    join.add("info", 40, "earlier")
    join.add("pose", 103, "nearer")
    assert done == [{"image": "photo", "pose": "nearer", "info": "earlier"}]
    join.add("image", 120, "alone")
    join.add("pose", 140, "too far")
    join.finish()
    assert len(done) == 1
    assert health.last_error == "unjoined: stamp 120 ns is incomplete, without pose (the recording or the node ended)"


class Heavy:
    """A message with so many bytes."""

    def __init__(self, size: int) -> None:
        self.data = bytes(size)


def test_what_waits_is_bounded_in_bytes() -> None:
    health = Health()
    done: list[dict[str, Any]] = []
    given_up: list[tuple[int, list[str], str]] = []
    join = StampJoin(
        ("image", "pose"),
        lambda **found: done.append(found),
        health,
        give_up=lambda *told: given_up.append(told),
        capacity_bytes=10 << 20,
    )
    for stamp in (3, 1, 2):
        join.add("image", stamp, Heavy(4 << 20))
    assert given_up == [(1, ["pose"], "later ones with 8 MB of data are queued")], "the oldest goes"
    join.add("image", 4, Heavy(20 << 20))
    assert [stamp for stamp, *_ in given_up] == [1, 2, 3], "one alone has room, whatever it holds"
    join.add("pose", 4, Heavy(0))
    assert len(done) == 1


def test_a_frame_that_fails_keeps_no_other_join_from_its_part(health: Health) -> None:
    """Two joins of a node listen to one topic, and two frames that both fail are both counted."""
    shared, done = Topic("/depth", SimpleNamespace), list[int]()

    class Handler(JoiningHandler[NodeConfig]):
        def __init__(self) -> None:
            super().__init__(NodeConfig(site="s.yaml"), Kept(), health)
            self._joins = [
                StampJoin({"depth": shared}, take, health) for take in (self._refuse, self._show, self._refuse)
            ]

        def _refuse(self, depth: Any) -> None:
            raise MessageError("no depth")

        def _show(self, depth: Any) -> None:
            done.append(stamp_of(depth))

    (take,) = Handler().subscriptions.values()
    with pytest.raises(MessageError):
        take(SimpleNamespace(header=make_header(7, "camera")))
    assert done == [7]
    assert health.dropped == {"message": 1}, "the last one is counted by whoever called"
