"""Read one camera: request images, check them, compute when and in which direction they were taken, and keep the
camera's state. Uses no ROS; tests replace the clock."""

import hashlib
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ltm_core.base.errors import CameraError, ImageError
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.zoom_lens import ZoomLens
from ltm_core.pose_estimation.mount.mount_model import MountModel
from ltm_core.site.source_config import SourceSettings
from ltm_msgs_py.image import picture_size
from ltm_ros.cameras.protocols.credentials import PictureError, SourceError, UnauthorisedError
from ltm_ros.cameras.protocols.exposure import Exposure, ExposureClock
from ltm_ros.cameras.protocols.picture import (
    CameraImage,
    CameraReader,
    Nothing,
    PtzHead,
    PtzReading,
    StuckPicture,
    Tolerance,
    at_rest,
    is_night,
    thumbnail_of_bytes,
)
from ltm_ros.runtime.clocks import SystemClock
from ltm_ros.runtime.health import CameraState, Health, StateRecord
from ltm_ros.runtime.retry import Backoff

FIRST_RETRY_S, LONGEST_RETRY_S = 1.0, 60.0
"""First and longest pause before a camera that failed is requested again."""
UNAUTHORISED_S = 600.0
"""Pause after a rejected password: cameras lock an account after a few of them within minutes."""
SETTLE_S = 1.0
"""Pause in seconds after an image taken while the PTZ head moved, so that it can stop."""
SET_BACK_NS = 10**10
"""Nanoseconds by which a stamp can precede the last one only if the clock was set; frames so far ahead are rejected
anyway."""


def camera_backoff(jitter: random.Random | None = None) -> Backoff:
    """Return the pauses between failing requests, with jitter: cameras behind one switch come back one by one."""
    return Backoff(FIRST_RETRY_S, LONGEST_RETRY_S, jitter or random.Random())  # nosec B311 # spreads load, guards nothing


@dataclass(frozen=True, eq=False)
class Frame:
    """A usable image. Either `jpeg` or `rgb` is given.

    `uncertainty`: seconds, see `Exposure`. `synchronised`: whether this computer's clock was; None: unknown."""

    stamp_ns: int
    uncertainty: float
    told_by: str
    synchronised: bool | None
    jpeg: bytes | None
    rgb: UInt8Array | None
    camera: Camera
    """Camera model of this image, because a lens may zoom."""
    pose: Pose | None
    covariance: Float64Array | None
    reading: PtzReading | None = None
    """Reading of the PTZ head just after the image."""


@dataclass(frozen=True)
class CameraDirection:
    """Source of a camera's pose: fixed, or from readings of its PTZ head and the mount; neither: published by another
    node."""

    pose: Pose | None = None
    covariance: Float64Array | None = None
    direction: PtzHead | None = None
    """None with a mount: readings come with the images."""
    mount: MountModel | None = None
    tolerance: Tolerance = field(default_factory=Tolerance)
    lens: ZoomLens | None = None
    """None: the lens does not zoom."""

    def of_reading(self, reading: PtzReading | None, calibration: Camera) -> tuple[Camera, Pose | None, Any]:
        """Return calibration, pose and its covariance. Raises CameraError if the zoom is out of range."""
        if reading is None:
            return calibration, self.pose, self.covariance
        camera = calibration if self.lens is None else self.lens.camera(reading.zoom)
        if self.mount is None:
            return camera, self.pose, self.covariance
        # The PTZ head may have moved by the tolerance although its readings show rest.
        moved = self.tolerance.angle_deg, self.tolerance.angle_deg
        return camera, *self.mount.pose(reading.pan_deg, reading.tilt_deg, moved)


class CameraSource:
    """Call `step` repeatedly, from one thread.

    Args: calibration: images must match it. open_reader: connects to the camera; raises SourceError. deliver: takes
    each frame. health: counts dropped images by cause, and holds the camera's state."""

    def __init__(
        self,
        settings: SourceSettings,
        calibration: Camera,
        gaze: CameraDirection,
        open_reader: Callable[[], CameraReader],
        deliver: Callable[[Frame], None],
        health: Health,
        clock: SystemClock,
        jitter: random.Random | None = None,
    ) -> None:
        self._settings, self._calibration, self._gaze = settings, calibration, gaze
        self._open, self._deliver, self._health, self._clock = open_reader, deliver, health, clock
        self._backoff = camera_backoff(jitter)
        self._reader: CameraReader | None = None
        self._exposures, self._stuck = ExposureClock(), StuckPicture(settings.stuck_s)
        self._connected_at = clock.monotonic()
        self.record = StateRecord(self._connected_at, settings.stall_s)
        self._before: PtzReading | None = None
        """Last reading of the PTZ head; None: none since the connection began."""
        self._digest, self._stamp_ns = b"", -1
        self._last_good: float | None = None
        self._night = False
        """Whether the last image was dark or infrared."""

    def step(self) -> float:
        """Request one image; return the seconds to wait before the next request."""
        begun = self._clock.monotonic()
        try:
            pause = self._ask()
        except UnauthorisedError as error:
            return self._failed(CameraState.UNAUTHORISED, error, UNAUTHORISED_S)
        except PictureError as error:
            self._health.drop("picture", str(error))
            if self._reader is None or (self._reader.pause == 0 and self._silent()):
                # A stream that sends nothing usable may recover when it is reopened.
                return self._failed(CameraState.STALLED, error, self._backoff.failed())
            self._become(CameraState.STALLED, str(error))
            pause = self._reader.pause
        except SourceError as error:
            return self._failed(CameraState.STALLED, error, self._backoff.failed())
        # Measured from start to start, however long the camera took.
        return max(0.0, begun + pause - self._clock.monotonic())

    def close(self) -> None:
        """Close all connections; `step` opens new ones."""
        reader, self._reader, self._before = self._reader, None, None
        if reader is not None:
            reader.close()
        if self._gaze.direction is not None:
            self._gaze.direction.close()

    def crashed(self, why: str) -> None:
        """Record a failure outside `step`."""
        self._become(CameraState.STALLED, why)

    def report(self) -> None:
        """Report the camera's state in the diagnostics."""
        now, wall = self._clock.monotonic(), self._clock.wall()
        health, record = self._health, self.record
        health.gauge("state", record.state.value)
        health.gauge("state_since", round(wall - (now - record.since)))
        health.gauge("state_why", record.why)
        health.gauge("stalled_after_s", self._settings.stall_s)
        health.lasting(f"{record.state}: {record.why}" if record.state.failing else "")
        if self._last_good is not None:
            health.gauge("picture_age_s", round(now - self._last_good, 1))
        offset = self._exposures.offset(wall - now)
        if offset is not None:
            health.gauge("camera_clock_ahead_s", round(offset, 3))
            health.gauge("camera_clock_resets", self._exposures.resets)

    def _ask(self) -> float:
        if self._reader is None:
            self._reader = self._open()
            self._connected_at = self._clock.monotonic()
            self._exposures.connected()
            self._health.note("connected")
        reader, gaze = self._reader, self._gaze
        # For snapshots, the direction is requested just before the image; for a stream, the reading after the
        # previous image serves as the one before this image.
        if gaze.direction is not None and (reader.pause > 0 or self._before is None):
            self._before = gaze.direction.read()
        item = reader.read()
        if item is Nothing.YET:
            if self._silent():
                self._become(CameraState.STALLED, "no new image")
        elif item is Nothing.UNCHANGED:
            self._repeated()
        else:
            assert isinstance(item, CameraImage)  # nosec B101 # tells the type checker what holds
            rested = self._take(item)
            self._backoff.succeeded()
            if not rested:
                return min(reader.pause, SETTLE_S)
        return reader.pause

    def _take(self, picture: CameraImage) -> bool:
        """Check an image, and deliver it if it is usable. Returns False if the PTZ head moved. Raises PictureError."""
        reading, before = picture.direction, self._before
        if self._gaze.direction is not None:
            self._before = reading = self._gaze.direction.read()
            rested = before is not None and at_rest(before, reading, self._gaze.tolerance)
        else:
            rested = reading is None or not reading.moving
        now = self._clock.monotonic()
        wall_less_monotonic = self._clock.wall() - now
        exposure = self._exposures.estimate(picture.timing, wall_less_monotonic)
        if not rested:
            self._health.drop("moved", "the PTZ head moved during the exposure; increase the time at each preset")
            self._become(CameraState.MOVED, "the PTZ head is moving")
            return False
        self._check_fit(picture)
        if picture.rgb is not None:
            thumbnail = picture.rgb[4::8, 4::8, ::-1].copy() if min(picture.rgb.shape[:2]) >= 8 else picture.rgb
        else:
            digest = hashlib.blake2b(picture.jpeg or b"", digest_size=16).digest()
            if digest == self._digest:
                self._repeated()
                return True
            self._digest = digest
            thumbnail = thumbnail_of_bytes(picture.jpeg or b"")
        self._stuck.look(thumbnail, reading, now)
        self._last_good = now
        self._night = night = is_night(thumbnail)
        if not night and (why := self._stuck.said(now)):
            self._health.drop("stuck", f"{why}: restart the camera")
            self._become(CameraState.STUCK, why)
            return True
        if night:
            self._become(CameraState.NIGHT, "dark, or without colour")
            if self._settings.night == "hold":
                self._health.note("night")
                return True
        else:
            self._become(CameraState.ALIVE)
        self._publish(picture, exposure, wall_less_monotonic, reading)
        return True

    def _check_fit(self, picture: CameraImage) -> None:
        """Check the image size. Raises PictureError with both sizes if the calibration has another."""
        if picture.rgb is not None:
            size = (picture.rgb.shape[1], picture.rgb.shape[0])
        else:
            try:
                size = picture_size(picture.jpeg or b"")
            except ImageError as error:
                raise PictureError(str(error)) from None
        wanted = (self._calibration.width, self._calibration.height)
        if size != wanted:
            raise PictureError(
                f"the image has {size[0]} x {size[1]} pixels, but the calibration in the site file is for "
                f"{wanted[0]} x {wanted[1]}: set the camera to that size, or calibrate it for this one"
            )

    def _publish(
        self, picture: CameraImage, exposure: Exposure, wall_less_monotonic: float, reading: PtzReading | None
    ) -> None:
        synchronised = self._clock.synchronised()
        self._health.gauge("clock_synchronised", {None: "unknown", True: "yes", False: "no"}[synchronised])
        if synchronised is False:
            self._health.note("unsynchronised")
        try:
            camera, pose, covariance = self._gaze.of_reading(reading, self._calibration)
        except CameraError as error:
            self._health.drop("zoom", str(error))
            return
        estimated_ns = stamp_ns = round((exposure.at + wall_less_monotonic) * 1e9)
        # Equal stamps count as one frame in all nodes. If the clock was set back, earlier stamps were wrong;
        # continuing from them would put all frames in the future until the clock has caught up.
        if stamp_ns <= self._stamp_ns < stamp_ns + SET_BACK_NS:
            stamp_ns = self._stamp_ns + 1
        self._stamp_ns = stamp_ns
        # An image after one whose time was estimated too late is late by that much itself.
        uncertainty = exposure.uncertainty + (stamp_ns - estimated_ns) / 1e9
        self._health.gauge("stamp_told_by", exposure.by)
        self._health.gauge("stamp_uncertainty_s", round(uncertainty, 3))
        image = picture.jpeg, picture.rgb
        self._deliver(
            Frame(stamp_ns, uncertainty, exposure.by, synchronised, *image, camera, pose, covariance, reading)
        )

    def _repeated(self) -> None:
        """Ignore an image equal to the previous one; publishing it would give it a new stamp."""
        now = self._clock.monotonic()
        self._backoff.succeeded()
        self._health.note("repeated")
        self._stuck.repeated(now)
        if not self._night and (why := self._stuck.said(now)):
            self._become(CameraState.STUCK, why)

    def _silent(self) -> bool:
        """Return whether a connected camera has sent no usable image for too long."""
        last = self._connected_at if self._last_good is None else self._last_good
        return self._clock.monotonic() - last >= self._settings.stall_s

    def _failed(self, state: CameraState, error: SourceError, wait_s: float) -> float:
        self.close()
        self._health.note("unauthorised" if state is CameraState.UNAUTHORISED else "disconnected")
        self._become(state, str(error))
        return wait_s

    def _become(self, state: CameraState, why: str = "") -> None:
        if self.record.saw(state, self._clock.monotonic(), why):
            self._health.note(f"became_{state.value}")
        self.report()
