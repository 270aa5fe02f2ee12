import ctypes
import time

import numpy as np
import pytest
from scenes.source_under_test import Sourced, TurnedClock, settings
from scenes.timed_picture import jpeg, scene

from ltm_ros.cameras.protocols.picture import (
    CameraImage,
    Nothing,
    PtzReading,
    StuckPicture,
    Timing,
    Tolerance,
    at_rest,
    is_night,
    thumbnail_of_bytes,
)
from ltm_ros.runtime.clocks import SystemClock


def test_night_is_dark_but_for_lamps_or_without_colour() -> None:
    image = scene(640, 360)
    lamps = image // 20
    lamps[100:120, 200:240] = 255
    for picture, night in ((image, False), (image // 20, True), (lamps, True), (image // 2, False)):
        assert is_night(thumbnail_of_bytes(jpeg(picture))) is night
    assert is_night(thumbnail_of_bytes(jpeg(image, "L")))
    fog = np.clip(200 + (image.astype(int) - 128) // 20, 0, 255).astype(np.uint8)
    assert not is_night(thumbnail_of_bytes(jpeg(fog)))


def test_stuck_after_so_long_and_well_again_at_the_first_change() -> None:
    stuck, same = StuckPicture(60.0), thumbnail_of_bytes(jpeg(scene(640, 360)))
    for now in (0.0, 30.0, 59.0):
        stuck.look(same, None, now)
        assert not stuck.said(now)
    stuck.repeated(61.0)
    assert stuck.said(61.0) == "the same image for 61 s"
    stuck.look(thumbnail_of_bytes(jpeg(scene(640, 360))), None, 70.0)
    assert not stuck.said(70.0)


def test_a_turn_that_the_picture_does_not_show() -> None:
    def look(stuck: StuckPicture, pan: float, seed: int) -> str:
        stuck.look(thumbnail_of_bytes(jpeg(scene(640, 360, seed))), PtzReading(pan, 0.0, 1.0, None, 0.0), pan)
        return stuck.said(pan)

    frozen, turning, still = StuckPicture(1e9), StuckPicture(1e9), StuckPicture(1e9)
    assert [bool(look(frozen, 30.0 * i, 3)) for i in range(4)] == [False, False, True, True]
    assert not any(look(turning, 30.0 * i, i) for i in range(6))
    assert not any(look(still, 1.0, 3) for _ in range(6))


def test_rest_is_two_equal_readings_of_a_head_that_does_not_say_that_it_moves() -> None:
    base = PtzReading(359.99, -3.0, 100.0, None, 0.0)
    for pan, tilt, zoom, moving, rests in (
        (0.01, -3.0, 100.0, None, True),
        (359.99, -3.02, 100.5, False, True),
        (0.10, -3.0, 100.0, None, False),
        (359.99, -2.9, 100.0, None, False),
        (359.99, -3.0, 102.0, None, False),
        (359.99, -3.0, 100.0, True, False),
    ):
        assert at_rest(base, PtzReading(pan, tilt, zoom, moving, 1.0), Tolerance()) is rests, (pan, tilt, zoom, moving)


def test_the_kernels_word_on_the_clock() -> None:
    clock = SystemClock()
    assert clock.synchronised() in (True, False)
    # Against a buffer that is larger than any kernel's: nothing was written beyond ours.
    buffer = ctypes.create_string_buffer(1024)
    assert (ctypes.CDLL(None).adjtimex(buffer) != 5) is clock.synchronised()
    assert not any(buffer.raw[208:])
    assert clock.wall() == pytest.approx(time.time(), abs=1.0)


class Pictures:
    """A reader that gives what a test has put there."""

    pause = 10.0

    def __init__(self) -> None:
        self.next: CameraImage | Nothing = Nothing.YET

    def read(self) -> CameraImage | Nothing:
        return self.next

    def close(self) -> None: ...


def test_frames_say_whether_the_clock_is_synchronised() -> None:
    clock, reader = TurnedClock(), Pictures()
    sourced = Sourced(settings(kind="snapshot", url="http://127.0.0.1/"), clock, reader=lambda: reader)
    for known in (False, True):
        clock.known_synchronised = known
        reader.next = CameraImage(Timing(clock.monotonic()), jpeg=jpeg(scene()))
        sourced.steps(1)
    assert [frame.synchronised for frame in sourced.frames] == [False, True]


def test_stamps_differ_even_where_two_times_are_equal_and_follow_a_clock_that_is_set() -> None:
    clock, reader = TurnedClock(), Pictures()
    sourced = Sourced(settings(kind="snapshot", url="http://127.0.0.1/"), clock, reader=lambda: reader)
    for step in (0.0, 0.0, 3600.0, -1.0, -7200.0, 0.0):
        clock.set(step)
        reader.next = CameraImage(Timing(clock.monotonic(), oldest=0.0), jpeg=jpeg(scene()))
        sourced.steps(1)
    first, second, third, fourth, fifth, sixth = (frame.stamp_ns for frame in sourced.frames)
    assert second == first + 1
    assert third - first == pytest.approx(3600e9, abs=1e4)
    assert fourth == third + 1, "a little back is no other time"
    assert fifth - first == pytest.approx(-3601e9, abs=1e4), "frames of the right time, not of one hours ahead"
    assert sixth == fifth + 1
