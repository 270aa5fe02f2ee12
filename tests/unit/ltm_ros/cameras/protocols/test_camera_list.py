import json
import time
from collections.abc import Iterator
from typing import Any

import pytest
from scenes.http_camera import HttpCamera, Request, running
from scenes.source_under_test import Sourced, settings

from ltm_ros.cameras.protocols.files import CameraListReader, time_of
from ltm_ros.cameras.protocols.picture import CameraImage, Nothing
from ltm_ros.runtime.clocks import SystemClock


@pytest.fixture
def listed() -> Iterator[tuple[HttpCamera, dict[str, Any]]]:
    """A network with two cameras, and the entry of the one that is asked, which a test may change."""
    entry: dict[str, Any] = {"id": "north", "az_current": 350.5, "tilt_current": -2.0, "zoom_current": 1}
    entry["last_frame_ts"] = time.time() - 20.0

    def answer(request: Request) -> None:
        if entry.get("slews"):
            entry["az_current"] = (entry["az_current"] + 1.0) % 360
        body = json.dumps({"cameras": [entry | {"id": "south", "az_current": 0.0}, entry]}).encode()
        request.answer(200, body, "application/json")

    with running() as camera:
        camera.routes |= {"/all.json": answer, "/north.jpg": Request.snapshot}
        yield camera, entry


def sourced_from(camera: HttpCamera) -> Sourced:
    config = settings(
        kind="camera_list", url=camera.url("/all.json"), image=camera.url("/{id}.jpg"), id="north", every=1
    )
    return Sourced(config, SystemClock())


def test_time_and_direction_come_from_the_list(listed: tuple[HttpCamera, dict[str, Any]]) -> None:
    camera, entry = listed
    reader = CameraListReader(sourced_from(camera).config, 1 << 20)
    picture = reader.read()
    assert isinstance(picture, CameraImage)
    assert picture.direction is not None
    assert (picture.direction.pan_deg, picture.direction.tilt_deg, picture.direction.moving) == (350.5, -2.0, None)
    assert picture.timing.taken is not None
    assert picture.timing.taken.epoch == pytest.approx(entry["last_frame_ts"])
    assert reader.read() is Nothing.UNCHANGED
    reader.close()


def test_the_stamp_is_the_lists_less_its_servers_clock(listed: tuple[HttpCamera, dict[str, Any]]) -> None:
    camera, entry = listed
    camera.behaviour.clock_ahead = 37.0
    sourced = sourced_from(camera)
    taken = []
    for _ in range(4):
        taken.append(time.time() - 20.0)
        entry["last_frame_ts"] = taken[-1] + 37.0
        sourced.steps(1)
    errors = [frame.stamp_ns / 1e9 - true for frame, true in zip(sourced.frames, taken, strict=True)]
    told = [frame.uncertainty for frame in sourced.frames]
    # A busy machine may leave this process between two looks at its own clocks.
    assert all(abs(error) <= most + 0.05 for error, most in zip(errors, told, strict=True)), (errors, told)
    assert sourced.frames[-1].told_by == "list"


def test_a_direction_that_changes_meanwhile_refuses_the_picture(listed: tuple[HttpCamera, dict[str, Any]]) -> None:
    camera, entry = listed
    entry["slews"] = True
    sourced = sourced_from(camera)
    sourced.steps(1)
    assert (sourced.state, sourced.frames, sourced.health.dropped) == ("moved", [], {"moved": 1})


@pytest.mark.parametrize(
    ("value", "epoch", "resolution"),
    [
        (1_790_000_000, 1_790_000_000.0, 1.0),
        (1_790_000_000_250, 1_790_000_000.25, 0.001),
        ("2026-09-21T13:33:20Z", 1_789_997_600.0, 1.0),
        ("2026-09-21 13:33:20.5", 1_789_997_600.5, 0.001),
    ],
)
def test_times(value: object, epoch: float, resolution: float) -> None:
    taken = time_of(value)
    assert taken is not None
    assert (taken.epoch, taken.resolution) == (pytest.approx(epoch), resolution)
    assert [time_of(no) for no in ("yesterday", None, True, float("nan"), -5)] == [None] * 5
