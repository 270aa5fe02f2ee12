import time
from typing import Any

import pytest
from scenes.http_camera import Behaviour, HttpCamera, Request, running
from scenes.source_under_test import Sourced, settings
from scenes.timed_picture import jpeg, scene, time_in

from ltm_core.storage.image_io import decode_rgb
from ltm_ros.runtime.clocks import SystemClock

FAST = {"frame_s": 0.02}


def sourced_from(camera: HttpCamera, **given: object) -> Sourced:
    return Sourced(settings(kind="mjpeg", url=camera.url("/stream.mjpg"), timeout=1.0, **given), SystemClock())


def test_pictures_come_as_they_are_sent_with_their_times() -> None:
    with running(HttpCamera(Behaviour(**FAST))) as camera:
        sourced = sourced_from(camera)
        read_at = []
        for _ in range(5):
            sourced.steps(1)
            read_at.append(time.time())
        sourced.source.close()
    assert (sourced.state, len(sourced.frames)) == ("alive", 5), sourced.why
    for frame, read in zip(sourced.frames, read_at, strict=True):
        # No earlier than it was taken; no later than it came, which on a busy machine is later than it was sent.
        assert time_in(decode_rgb(frame.jpeg or b"")) - frame.uncertainty - 0.05 <= frame.stamp_ns / 1e9 <= read
        assert frame.uncertainty < 0.5


FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "ends": ({"frames": 3}, "ended"),
    "silent": ({"stall_within_s": 3.0}, "does not respond"),
    "cut": ({"cut": True}, "ended"),
    "no JPEG": ({"garbage": b"nothing of use"}, "not a JPEG"),
    "too large": ({"render": lambda _: b"\xff\xd8\xff" + bytes(5 << 20)}, "maximum"),
    "other size": ({"render": lambda _: jpeg(scene(640, 360))}, "640 x 360"),
}


@pytest.mark.parametrize(("broken", "said"), FAULTS.values(), ids=FAULTS)
def test_what_goes_wrong(broken: dict[str, Any], said: str) -> None:
    with running(HttpCamera(Behaviour(**FAST))) as camera:
        sourced = sourced_from(camera, stalled_after=0.2)
        for name, value in broken.items():
            setattr(camera.behaviour, name, value)
        for _ in range(60):
            sourced.steps(1)
            if sourced.state == "stalled" and said in sourced.why:
                break
        assert (sourced.state, said in sourced.why) == ("stalled", True), sourced.why
        camera.behaviour = Behaviour(**FAST)
        before = len(sourced.frames)
        for _ in range(60):
            sourced.steps(1)
            if len(sourced.frames) >= before + 2:
                break
        assert sourced.state == "alive", sourced.why
        sourced.source.close()


@pytest.mark.parametrize("stamp", ["nan", "inf", "-1e999", "noon"])
def test_a_count_that_is_no_number_is_none(stamp: str) -> None:
    def stream(request: Request) -> None:
        request.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=x\r\n\r\n")
        for _ in range(3):
            body = jpeg(scene())
            request.wfile.write(b"--x\r\nX-Timestamp: %b\r\n\r\n%b\r\n" % (stamp.encode(), body))
        request.wfile.write(b"--x--\r\n")
        request.close_connection = True

    with running(HttpCamera(routes={"/stream.mjpg": stream})) as camera:
        sourced = sourced_from(camera)
        sourced.steps(2)
        sourced.source.close()
    assert (sourced.state, len(sourced.frames)) == ("alive", 2), sourced.why
