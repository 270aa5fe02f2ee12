"""Open a camera as its site file describes, warn about missing parts, and read it in a thread of its own."""

import random
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.base.redaction import redacted
from ltm_core.geometry.camera import Camera
from ltm_core.site.sections import CameraConfig
from ltm_core.site.site import Site
from ltm_core.site.source_config import (
    CameraListConfig,
    FolderConfig,
    HttpSettings,
    MjpegConfig,
    NetworkSettings,
    RtspConfig,
    SnapshotConfig,
    SourceConfig,
)
from ltm_core.storage.disk_io import is_file, is_folder
from ltm_ros.cameras.camera_source import CameraDirection, CameraSource, Frame, camera_backoff
from ltm_ros.cameras.protocols.credentials import UnauthorisedError, read_secret
from ltm_ros.cameras.protocols.files import CameraListReader, FolderReader
from ltm_ros.cameras.protocols.http_pictures import MjpegReader, SnapshotReader
from ltm_ros.cameras.protocols.picture import CameraReader, Tolerance
from ltm_ros.cameras.protocols.video import RtspReader
from ltm_ros.cameras.ptz.head import PtzDirection, tolerance_of
from ltm_ros.cameras.ptz.makers import open_ptz
from ltm_ros.runtime.clocks import SystemClock
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.heartbeat import Activity


def doubts_of(source: SourceConfig) -> Iterator[str]:
    """Return warnings with remedies. They are no errors, because a service may have access that a shell lacks."""
    if isinstance(source, NetworkSettings) and source.password is not None:
        try:
            read_secret(source.password)
        except UnauthorisedError as error:
            yield str(error)
    if isinstance(source, RtspConfig) and find_spec("av") is None:
        yield 'video needs PyAV: pip install "ltm[rtsp]"'
    if isinstance(source, HttpSettings) and source.ca is not None and not is_file(source.ca):
        yield f"ca {source.ca} does not exist"
    if isinstance(source, FolderConfig) and not is_folder(source.path):
        yield f"{source.path} is not a folder: create it, or correct path"


def calibration_of(camera: CameraConfig, name: str) -> Camera:
    """Return the calibration, at the widest zoom. Raises ConfigError if the site file has none."""
    if camera.mount is not None and camera.mount.lens is not None:
        lens = camera.mount.lens.lens()
        return lens.camera(lens.table[0][0])
    if camera.calibration is None:
        raise ConfigError(f"camera {name} has neither calibration nor mount.lens in the site file")
    return camera.calibration.camera()


def direction_of(site: Site, camera: CameraConfig) -> CameraDirection:
    """Return the pose source, without connecting: the stated pose of a fixed camera, or poses from the readings of a
    PTZ head. Raises as `MountConfig.model`."""
    if camera.mount is not None:
        ptz, source = camera.ptz, camera.source
        tolerance = Tolerance() if ptz is None else tolerance_of(ptz)
        return CameraDirection(
            direction=None if ptz is None else PtzDirection(lambda: open_ptz(ptz, source), tolerance),
            mount=camera.mount.model(site.open_dem(), site.frame),
            tolerance=tolerance,
            lens=None if camera.mount.lens is None else camera.mount.lens.lens(),
        )
    if camera.pose is None:
        return CameraDirection()
    pose = camera.pose.pose(site.open_dem(), site.frame)
    assumed = site.assumed_pose_error
    covariance = camera.pose.covariance(pose, assumed.position, assumed.angle_deg)
    return CameraDirection(pose, assumed.covariance() if covariance is None else covariance)


def open_reader(config: SourceConfig, most_bytes: int, clock: SystemClock) -> CameraReader:
    """Open a reader. `most_bytes`: maximum size of an image. Raises SourceError."""
    match config:
        case SnapshotConfig():
            return SnapshotReader(config, most_bytes)
        case MjpegConfig():
            return MjpegReader(config, most_bytes)
        case RtspConfig():
            return RtspReader(config)
        case FolderConfig():
            return FolderReader(config, most_bytes, clock)
        case CameraListConfig():
            return CameraListReader(config, most_bytes)


def source_of(
    site: Site, name: str, config: SourceConfig, deliver: Callable[[Frame], None], health: Health
) -> CameraSource:
    """Return the source of a camera, which `deliver` gets frames from, without connecting. Raises ConfigError."""
    camera, clock = site.camera(name), SystemClock()
    reader = partial(open_reader, config, site.limits.image_bytes, clock)
    return CameraSource(
        config, calibration_of(camera, name), direction_of(site, camera), reader, deliver, health, clock
    )


SPREAD_S = 2.0
"""Seconds over which the first requests to a process's cameras are spread."""
END_S = 2.0
"""Maximum seconds to wait at the end for a request in progress."""


class SourceThread:
    """Runs `source.step` until `stop`; a bug in it is counted (`crash`) and reported, and the step is tried again
    later."""

    def __init__(self, name: str, source: CameraSource, health: Health, activity: Activity) -> None:
        self._name, self._source, self._health, self._activity = name, source, health, activity
        self._stopping = threading.Event()
        self._crashes = camera_backoff()
        self._thread = threading.Thread(target=self._run, name=f"source {name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Stop after the current step; waits for a moment."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join(END_S)

    def _run(self) -> None:
        pause = random.uniform(0.0, SPREAD_S)  # nosec B311 # spreads load, guards nothing
        while not self._stopping.wait(pause):
            with self._activity.turn(f"image of {self._name}"):
                pause = self._step()
        self._source.close()

    def _step(self) -> float:
        try:
            pause = self._source.step()
            self._crashes.succeeded()
            return pause
        except LtmError as error:
            cause, why = cause_of(error), str(error)
        except Exception as error:
            self._tell(error)
            cause, why = "crash", f"{type(error).__name__}: internal error, see the log; the camera is tried again"
            try:
                self._source.close()
            except Exception as another:  # a connection left incomplete by the bug is dropped all the same
                self._tell(another)
        self._health.drop(cause, why)
        self._source.crashed(why)
        return self._crashes.failed()

    @staticmethod
    def _tell(error: Exception) -> None:
        # Its message may contain secrets passed to another library.
        print(redacted("".join(traceback.format_exception(error, chain=False))), file=sys.stderr)
