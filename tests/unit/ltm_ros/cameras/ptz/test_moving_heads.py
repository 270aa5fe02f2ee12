import io
import math
import time
from collections.abc import Iterator

import numpy as np
import PIL.Image
import pytest
from scenes.http_camera import HttpCamera, running
from scenes.ptz_camera import FakeHead, direction_in, ptz_camera
from scenes.source_under_test import Sourced, settings
from scenes.timed_picture import jpeg, scene

from ltm_core.geometry.pose import Pose
from ltm_core.geometry.zoom_lens import LensConfig, ZoomPoint
from ltm_core.pose_estimation.mount.mount_model import MountModel
from ltm_core.site.source_config import VapixConfig
from ltm_ros.cameras.camera_source import CameraDirection, Frame
from ltm_ros.cameras.protocols.picture import CameraImage, PtzReading, Timing
from ltm_ros.cameras.ptz.head import PtzDirection, tolerance_of
from ltm_ros.cameras.ptz.makers import open_ptz
from ltm_ros.runtime.clocks import SystemClock

MODEL = MountModel(Pose.from_angles((10.0, 20.0, 900.0), 30.0, 0.8, -0.5), math.radians(0.3), np.zeros((7, 7)))
TABLE = (ZoomPoint(zoom=1, hfov_deg=62.0), ZoomPoint(zoom=9999, hfov_deg=2.3))
LENS = LensConfig(width=320, height=180, zoom=TABLE).lens()


def sourced(camera: HttpCamera, lens: bool = False) -> Sourced:
    source, config = settings(kind="snapshot", url=camera.url(), every=0.01), VapixConfig(kind="vapix")
    tolerance = tolerance_of(config)
    direction = PtzDirection(lambda: open_ptz(config, source), tolerance)
    gaze = CameraDirection(direction=direction, mount=MODEL, tolerance=tolerance, lens=LENS if lens else None)
    return Sourced(source, SystemClock(), gaze=gaze)


def seen(frame: Frame) -> tuple[float, float]:
    assert frame.jpeg is not None
    return direction_in(np.asarray(PIL.Image.open(io.BytesIO(frame.jpeg)).convert("RGB")))


def off_deg(frame: Frame) -> float:
    """Between the pose that was told and what the picture shows."""
    assert frame.pose is not None
    truth = MODEL.rotation(*seen(frame))
    return math.degrees(math.acos(min(1.0, float(frame.pose.rotation[:, 2] @ truth[:, 2]))))


@pytest.fixture
def head() -> FakeHead:
    return FakeHead(place=(123.4, -7.2, 1.0), rate=3000.0)


@pytest.fixture
def camera(head: FakeHead) -> Iterator[HttpCamera]:
    with running(ptz_camera(head)) as camera:
        yield camera


def test_at_rest_no_picture_is_refused_and_the_pose_is_that_of_the_picture(camera: HttpCamera) -> None:
    tested = sourced(camera)
    tested.steps(8)
    assert len(tested.frames) == 8
    assert not tested.health.dropped
    assert max(off_deg(frame) for frame in tested.frames) < 0.01
    covariance = tested.frames[0].covariance
    assert covariance is not None
    assert 0.03 < math.degrees(math.sqrt(covariance[5, 5])) < 0.04


@pytest.mark.parametrize(
    "rate", [-1.0, 1.0, *(pytest.param(rate, marks=pytest.mark.slow) for rate in (2.0, 5.0, 20.0)), 90.0]
)
def test_while_the_head_slews_every_picture_is_refused(camera: HttpCamera, head: FakeHead, rate: float) -> None:
    tested = sourced(camera)
    tested.steps(1)
    if rate < 0:
        pan, tilt, zoom = head.encoders()
        head.rate, head.starts_after_s = -rate, 0.0
        head.send((pan - 600.0, tilt, zoom))
    else:
        head.slew(rate)
    tested.steps(5)
    assert len(tested.frames) == 1
    assert tested.health.dropped["moved"] == 5
    assert tested.state == "moved"


def test_focal_length_follows_the_zoom(camera: HttpCamera, head: FakeHead) -> None:
    tested = sourced(camera, lens=True)
    tested.steps(1)
    head.rate, head.starts_after_s = 1e6, 0.0
    head.send((123.4, -7.2, 4000.0))
    tested.steps(1)
    wide, long = tested.frames
    assert wide.camera.hfov_deg == pytest.approx(62.0, abs=0.01)
    assert long.camera == LENS.camera(4000.0)
    assert long.camera.fx > 5 * wide.camera.fx


def test_directions_that_come_with_the_pictures_need_the_mount_alone() -> None:
    reading = PtzReading(123.4, -7.2, 4000.0, None, 0.0)
    pictures = [jpeg(scene(seed=k)) for k in range(3)]

    class Listed:
        pause = 1.0

        def read(self) -> CameraImage:
            now = time.monotonic()
            return CameraImage(Timing(arrived=now, asked=now), jpeg=pictures.pop(), direction=reading)

        def close(self) -> None:
            """It has no connection."""

    gaze = CameraDirection(mount=MODEL, lens=LENS)
    tested = Sourced(settings(kind="snapshot", url="http://127.0.0.1"), SystemClock(), gaze=gaze, reader=Listed)
    tested.steps(2)
    frame = tested.frames[-1]
    assert frame.pose == MODEL.pose(123.4, -7.2)[0]
    assert frame.camera == LENS.camera(4000.0)


def test_a_head_that_cannot_be_asked_ends_in_no_picture(camera: HttpCamera) -> None:
    tested = sourced(camera)
    tested.steps(1)
    page = camera.routes.pop("/axis-cgi/com/ptz.cgi")
    tested.steps(2)
    assert len(tested.frames) == 1
    assert tested.state == "stalled"
    assert "404" in tested.why
    camera.routes["/axis-cgi/com/ptz.cgi"] = page
    tested.steps(1)
    assert len(tested.frames) == 2
