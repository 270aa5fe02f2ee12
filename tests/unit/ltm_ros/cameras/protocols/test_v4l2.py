from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from scenes.source_under_test import Sourced, settings
from scenes.timed_picture import scene, time_in, with_time

from ltm_ros.cameras.opening import doubts_of
from ltm_ros.runtime.clocks import SystemClock

av = pytest.importorskip("av", reason="the extra rtsp is not installed")

PICTURES, RATE = 12, 4
NOBODY = Path("/dev/ltm-no-such-camera")


def camera(**given: object) -> Any:
    return settings(kind="v4l2", device=str(NOBODY), **given)


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, dict[str, Any]]]:
    """What PyAV is asked for instead of opening it: it gives pictures that show their own time, a quarter of a second
    apart."""
    path = tmp_path / "camera.avi"
    with av.open(str(path), "w") as file:
        stream = file.add_stream("mjpeg", rate=RATE)
        stream.width, stream.height, stream.pix_fmt = 320, 180, "yuvj420p"
        for number in range(PICTURES):
            image = with_time(scene(), number / RATE)
            file.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        file.mux(stream.encode(None))
    calls: list[tuple[Any, dict[str, Any]]] = []
    really = av.open

    def opened(device: str, **given: Any) -> Any:
        calls.append((device, given))
        return really(str(path))

    monkeypatch.setattr(av, "open", opened)
    return calls


def test_a_cameras_pictures_with_its_own_times(asked: list[tuple[Any, dict[str, Any]]]) -> None:
    sourced = Sourced(camera(every=0, size=[320, 180], rate=4, format="mjpeg"), SystemClock())
    while sourced.state in ("connecting", "alive"):
        sourced.source.step()
    ((device, given),) = asked
    assert (device, given["format"]) == (str(NOBODY), "v4l2")
    assert given["options"] == {"video_size": "320x180", "framerate": "4", "input_format": "mjpeg"}
    shown = [time_in(frame.rgb) for frame in sourced.frames if frame.rgb is not None]
    assert shown == [pytest.approx(number / RATE, abs=0.001) for number in range(PICTURES)]
    assert {frame.told_by for frame in sourced.frames} == {"timestamp"}
    # A camera that is pulled out ends its video.
    assert (sourced.state, sourced.why) == (
        "stalled",
        "the stream has ended: the camera closed it or is not reachable",
    )


def test_a_camera_that_is_not_there_or_belongs_to_others_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    sourced = Sourced(camera(size=[320, 180]), SystemClock())
    sourced.steps(1)
    assert sourced.state == "stalled"
    assert sourced.why == f"{NOBODY}: No such file or directory; requested video_size 320x180"
    assert [doubt.partition(":")[0] for doubt in doubts_of(sourced.config)] == [f"{NOBODY} does not exist"]

    def refused(*given: Any, **more: Any) -> Any:
        raise av.error.PermissionError(13, "Permission denied")

    monkeypatch.setattr(av, "open", refused)
    sourced.steps(1)
    assert "group video" in sourced.why


@pytest.mark.parametrize("device", ["video0", "/etc/passwd", "/dev/../etc/passwd"])
def test_only_devices_are_read(device: str) -> None:
    with pytest.raises(ValidationError, match="below /dev"):
        settings(kind="v4l2", device=device)
