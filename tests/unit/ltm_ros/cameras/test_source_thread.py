"""The thread that asks a camera outlives whatever goes wrong there."""

import pytest
from scenes.source_under_test import Sourced, settings
from scenes.timed_picture import jpeg, scene
from scenes.waiting import wait_for

from ltm_core.geometry.camera import Camera
from ltm_ros.cameras import opening as source_thread
from ltm_ros.cameras.opening import SourceThread
from ltm_ros.cameras.protocols.picture import CameraImage, Nothing, Timing
from ltm_ros.runtime.clocks import SystemClock
from ltm_ros.runtime.heartbeat import Activity


class Broken:
    """A connection that a bug ends, and that cannot be closed then."""

    pause = 0.01

    def read(self) -> CameraImage | Nothing:
        raise KeyError("a bug of ours")

    def close(self) -> None:
        raise RuntimeError("password=hunter2")


class Whole:
    pause = 0.01

    def read(self) -> CameraImage | Nothing:
        return CameraImage(Timing(arrived=0.0, oldest=0.0), jpeg=jpeg(scene(320, 180)))

    def close(self) -> None:
        """Nothing is open."""


def test_a_connection_that_cannot_be_closed_after_a_bug_does_not_end_the_asking(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(source_thread, "SPREAD_S", 0.0)
    readers = iter([Broken(), Whole()])
    config = settings(kind="snapshot", url="http://192.0.2.1/a.jpg")
    sourced = Sourced(config, SystemClock(), Camera.from_fov(320, 180, 60.0), reader=lambda: next(readers))
    thread = SourceThread("north", sourced.source, sourced.health, Activity("source north"))
    thread.start()
    try:
        wait_for(lambda: sourced.frames, "a picture", sourced.health.summary)
    finally:
        thread.stop()
    assert sourced.health.dropped == {"crash": 1}
    assert sourced.state == "alive"
    said = capsys.readouterr().err
    assert "a bug of ours" in said
    assert "RuntimeError" in said
    assert "hunter2" not in said
