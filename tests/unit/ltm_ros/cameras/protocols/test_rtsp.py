import time
import traceback

import numpy as np
import pytest
from scenes.rtsp_camera import PASSWORD, SIZE, USER, RtspCamera, running
from scenes.source_under_test import Sourced, settings
from scenes.timed_picture import time_in

from ltm_core.geometry.camera import Camera
from ltm_ros.cameras.opening import open_reader
from ltm_ros.cameras.protocols.credentials import UnauthorisedError
from ltm_ros.runtime.clocks import SystemClock

CALIBRATION = Camera.from_fov(*SIZE, 62.0)


def sourced_from(camera: RtspCamera, **given: object) -> Sourced:
    login = {"user": USER, "password": {"environment": "NORTH"}} if camera.authentication else {}
    config = settings(kind="rtsp", url=camera.url, timeout=3.0, **(login | given))
    return Sourced(config, SystemClock(), CALIBRATION)


def until(sourced: Sourced, frames: int, patience_s: float = 40.0) -> None:
    """Steps, with pauses of a moment, until so many frames have come."""
    deadline = time.monotonic() + patience_s
    while len(sourced.frames) < frames:
        time.sleep(min(sourced.source.step(), 0.2))
        assert time.monotonic() < deadline, (sourced.state, sourced.why)


def errors_and_told(sourced: Sourced) -> tuple[np.ndarray, np.ndarray]:
    errors = [frame.stamp_ns / 1e9 - time_in(frame.rgb) for frame in sourced.frames if frame.rgb is not None]
    return np.array(errors), np.array([frame.uncertainty for frame in sourced.frames])


@pytest.mark.parametrize("frames", [pytest.param("all", marks=pytest.mark.slow), "key"])
def test_stamps_of_a_camera_whose_clock_is_wrong_by_37_seconds(monkeypatch: pytest.MonkeyPatch, frames: str) -> None:
    monkeypatch.setenv("NORTH", PASSWORD)
    with running(RtspCamera(ahead=37.0, authentication="digest")) as camera:
        sourced = sourced_from(camera, frames=frames)
        until(sourced, 40 if frames == "all" else 6)
        sourced.source.report()
        sourced.source.close()
    errors, told = errors_and_told(sourced)
    assert sourced.state == "alive"
    assert np.median(np.abs(errors)) < 0.05
    assert np.quantile(np.abs(errors), 0.95) < 0.05
    assert (np.abs(errors) <= told).mean() >= 0.95
    assert float(sourced.health.summary()["camera_clock_ahead_s"]) == pytest.approx(37.0, abs=0.1)
    # Every picture, or one of five.
    taken = np.diff([time_in(frame.rgb) for frame in sourced.frames if frame.rgb is not None])
    assert np.median(taken) == pytest.approx(0.1 if frames == "all" else 0.5, abs=0.03)


@pytest.mark.parametrize("authentication", ["basic", "digest"])
def test_a_wrong_password_is_refused_and_not_told(monkeypatch: pytest.MonkeyPatch, authentication: str) -> None:
    monkeypatch.setenv("NORTH", "wrong-%7 guess")
    with running(RtspCamera(authentication=authentication)) as camera:
        sourced = sourced_from(camera)
        (pause,) = sourced.steps(1)
        assert (sourced.state, pause >= 600) == ("unauthorised", True)
        with pytest.raises(UnauthorisedError) as caught:
            open_reader(sourced.config, 1 << 20, sourced.clock)
        said = "".join(traceback.format_exception(caught.value)) + str(sourced.health.summary()) + sourced.why
        assert "guess" not in said


@pytest.mark.slow
def test_a_stream_that_stalls_or_dies_comes_back_by_itself() -> None:
    with running(RtspCamera(ahead=-12.0)) as camera:
        sourced = sourced_from(camera, frames="all")
        until(sourced, 30)
        for harm, mend in ((camera.stall, camera.go_on), (camera.kill, camera.start)):
            harm()
            deadline = time.monotonic() + 20.0
            while sourced.state != "stalled":
                time.sleep(min(sourced.source.step(), 0.2))
                assert time.monotonic() < deadline
            mend()
            until(sourced, len(sourced.frames) + 30)
            assert sourced.state == "alive"
        sourced.source.close()
    errors, told = errors_and_told(sourced)
    assert (np.abs(errors) <= told).mean() >= 0.95
    assert sorted(frame.stamp_ns for frame in sourced.frames) == [frame.stamp_ns for frame in sourced.frames]
