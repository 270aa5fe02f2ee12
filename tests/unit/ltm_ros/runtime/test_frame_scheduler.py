import threading
from dataclasses import dataclass, field

from scenes.waiting import wait_for

from ltm_ros.runtime.camera_pipeline import FrameScheduler
from ltm_ros.runtime.heartbeat import Activity, Heartbeat


@dataclass(eq=False)
class Camera:
    """Wants so many turns in all, once it is woken."""

    name: str
    wants: int
    log: list[str]

    def turn(self, activity: Activity) -> bool:
        self.log.append(self.name)
        self.wants -= 1
        return self.wants > 0


def test_cameras_that_always_have_more_get_turns_one_after_the_other() -> None:
    log: list[str] = []
    scheduler = FrameScheduler(1, Heartbeat())
    for name, wants in (("a", 4), ("b", 2), ("c", 3)):
        scheduler.wake(Camera(name, wants, log))
    scheduler.start()
    assert scheduler.close(30.0)
    assert log == ["a", "b", "c", "a", "b", "c", "a", "c", "a"]


@dataclass(eq=False)
class Slow:
    """Its turns last until they are let go."""

    begun: list[str]
    name: str = "slow"
    go_on: threading.Event = field(default_factory=threading.Event)
    at_once: int = 0
    most_at_once: int = 0

    def turn(self, activity: Activity) -> bool:
        self.at_once += 1
        self.most_at_once = max(self.most_at_once, self.at_once)
        self.begun.append(self.name)
        assert self.go_on.wait(30.0)
        self.at_once -= 1
        return False


def test_who_is_woken_during_its_turn_gets_another_and_never_two_at_once() -> None:
    begun: list[str] = []
    slow, other = Slow(begun), Slow(begun, "other")
    scheduler = FrameScheduler(3, Heartbeat())
    scheduler.start()
    scheduler.wake(slow)
    wait_for(lambda: begun == ["slow"], "its turn")
    for _ in range(5):
        scheduler.wake(slow)
    scheduler.wake(other)
    wait_for(lambda: begun == ["slow", "other"], "the other's turn beside it")
    slow.go_on.set()
    other.go_on.set()
    assert scheduler.close(30.0)
    assert begun == ["slow", "other", "slow"]
    assert slow.most_at_once == 1
