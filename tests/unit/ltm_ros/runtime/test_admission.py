from __future__ import annotations

import pytest

from ltm_core.base.errors import ImageError
from ltm_ros.runtime.admission import Admission
from ltm_ros.runtime.health import Health


class Door:
    """An admission of frames that are their own stamps; each holds ten bytes."""

    def __init__(self, shed: bool) -> None:
        self.health, self.admitted, self.more = Health(), list[int](), True
        self.admission = Admission[int](self._admit, self.health, shed, lambda _: 10, 50, lambda: self.more)

    def offer(self, *stamps: int) -> None:
        for stamp in stamps:
            self.admission.offer(stamp, stamp)

    def waiting(self) -> str:
        return self.health.summary()["waiting"]

    def _admit(self, frame: int) -> None:
        if frame < 0:
            raise ImageError(f"frame {frame}")
        self.admitted.append(frame)


def test_only_the_newest_waits_and_without_others_none_does() -> None:
    door = Door(shed=True)
    door.offer(1, 2, 5, 4)
    assert (door.admitted, door.waiting(), door.health.dropped) == ([], "1", {"shed": 3})
    door.admission.idle()
    assert (door.admitted, door.waiting()) == ([5], "0"), "the newest by stamp"
    door.more = False
    door.offer(6, 7)
    assert door.admitted == [5, 6, 7]


def test_a_recording_waits_in_order_bounded_in_bytes() -> None:
    door = Door(shed=False)
    door.offer(1, 2, 3, 5, 4, 6, 7)
    assert (door.waiting(), door.health.dropped) == ("5", {"shed": 2})
    for _ in range(9):
        door.admission.idle()
    assert door.admitted == [3, 5, 4, 6, 7]
    door.offer(8)
    door.admission.finish()
    assert (door.waiting(), door.health.dropped) == ("0", {"shed": 3})


def test_a_frame_that_is_none_does_not_hold_up_the_next() -> None:
    door = Door(shed=False)
    door.offer(-1, 2)
    with pytest.raises(ImageError):
        door.admission.idle()
    door.admission.idle()
    assert door.admitted == [2]
