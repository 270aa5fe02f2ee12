"""capture: joins a camera's images, calibration and poses, checks them, and lets them into the camera's chain of nodes
under one stamp, as many as these can finish."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field

from ltm_core.camera import Camera
from ltm_core.errors import ImageError
from ltm_core.frame import PosedImage
from ltm_core.pose import Pose
from ltm_core.pose_estimation.pose_correction import PoseCorrection
from ltm_core.sensor_pose import Attitude, Fix, sensed_pose
from ltm_core.site_io import load_site
from ltm_core.types import Float64Array
from ltm_msgs_py.camera_info import camera_to_msg, msg_to_camera
from ltm_msgs_py.image import compressed_size, compressed_to_rgb, image_to_msg, msg_to_rgb
from ltm_msgs_py.imu import msg_to_attitude
from ltm_msgs_py.navsat import msg_to_fix
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose, pose_to_msg
from ltm_msgs_py.pose_correction import msg_to_correction
from ltm_msgs_py.stamp import stamp_of, time_to_ns
from ltm_ros.runtime.admission import Admission
from ltm_ros.runtime.handler import Handler, NodeConfig, NodeType, Outlet, Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.stamp_check import StampCheck
from ltm_ros.runtime.stamp_join import Match, Part, StampJoin, data_bytes
from ltm_ros.runtime.topics import (
    CAMERA_INFO,
    FINISHED,
    FIX,
    IMAGE_COMPRESSED,
    IMAGE_RAW,
    IMU,
    POSE,
    POSE_CORRECTION,
    POSED_CAMERA_INFO,
    POSED_IMAGE,
    POSED_POSE,
    STATED_POSE,
)


class CaptureConfig(NodeConfig):
    pose_tolerance: float = Field(0.0, ge=0)
    """Seconds by which a pose's stamp may miss its image's. 0: stamps must be equal."""
    max_wait: float = Field(3.0, gt=0)
    """Seconds that an image waits for its pose and calibration."""
    max_waiting: int = Field(20, ge=1)
    """Images that wait for their pose and calibration at most; beyond it the oldest is dropped."""
    in_flight: int = Field(2, ge=1)
    """Frames that the camera's nodes work on at most: one is labelled while another is fused."""
    finish_within: float = Field(10.0, gt=0)
    """Seconds after which a node that has frames and finishes none is not waited for, until it finishes one."""
    shed: bool = True
    """While so many are in flight, the newest frame waits and those before it are turned away. False, as in a replay:
    all wait in order, up to `waiting_bytes` of the site's limits."""


@dataclass(frozen=True)
class _Frame:
    image: Any
    pose: Pose
    covariance: Any
    camera: Camera


def _view_of(frame: _Frame) -> Hashable:
    """The direction in which a frame was taken, in steps of a quarter of what it shows."""
    camera, axis = frame.camera, frame.pose.rotation[:, 2]
    step = math.atan2(camera.width, 2 * camera.fx) / 2
    azimuth, pitch = math.atan2(axis[0], axis[1]), math.asin(max(-1.0, min(1.0, axis[2])))
    return round(azimuth / step), round(pitch / step)


class Capture(Handler[CaptureConfig]):
    """An image leaves when its pose and a calibration are there (the newest calibration up to its stamp counts), and
    when the nodes that work on the camera's frames have room for it (`Admission`)."""

    publications: Sequence[Topic] = (POSED_IMAGE, POSED_CAMERA_INFO, POSED_POSE)

    def __init__(self, config: CaptureConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = load_site(config.site)
        camera = site.camera(config.camera)
        self._raw = camera.image == "raw"
        self._frame_id = f"{config.camera}_optical"
        self._fixed_pose: Pose | None = None
        self._fixed_covariance: Float64Array | None = None
        if camera.pose is not None:
            self._fixed_pose = camera.pose.pose(site.open_dem(), site.frame)
            assumed = site.assumed_pose_error
            self._fixed_covariance = camera.pose.covariance(self._fixed_pose, assumed.position, assumed.angle_deg)
        self._fixed_calibration = camera.calibration.camera() if camera.calibration else None
        parts = [Part("image")]
        self._sensors, self._frame = camera.sensors, site.frame
        self._dem = site.open_dem() if camera.sensors is not None else None
        if camera.sensors is not None:
            parts.append(Part("fix", Match.LATEST))
            parts.append(Part("attitude", Match.NEAREST, round(camera.sensors.attitude_age * 1e9)))
        elif self._fixed_pose is None:
            parts.append(Part("pose", Match.NEAREST, round(config.pose_tolerance * 1e9)))
        if self._fixed_calibration is None:
            parts.append(Part("calibration", Match.LATEST))
        self._limits = site.limits
        self._refines = site.refine_poses is not None
        if self._refines:
            self.publications = (*self.publications, STATED_POSE)
        self._correction: PoseCorrection | None = None
        self._assumed = site.assumed_pose_error.covariance()
        self._stamps = StampCheck(outlet.now_ns, health)
        self._join = StampJoin(
            parts,
            self._offer,
            health,
            config.max_waiting,
            max_wait=config.max_wait,
            give_up=self._give_up,
            capacity_bytes=site.limits.waiting_bytes,
        )
        self._admission = Admission[_Frame](
            self._send,
            lambda: outlet.workers(FINISHED),
            health,
            config.in_flight,
            config.finish_within,
            config.shed,
            lambda frame: data_bytes(frame.image),
            site.limits.waiting_bytes,
            outlet.more_waits,
            _view_of,
        )
        self._newest = -1

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        topics: dict[Any, Callable[[Any], None]] = {IMAGE_RAW if self._raw else IMAGE_COMPRESSED: self.on_image}
        topics[FINISHED] = self.on_finished
        if self._refines:
            topics[POSE_CORRECTION] = self.on_correction
        if self._fixed_calibration is None:
            topics[CAMERA_INFO] = self.on_camera_info
        if self._sensors is not None:
            topics |= {FIX: self.on_fix, IMU: self.on_imu}
        elif self._fixed_pose is None:
            topics[POSE] = self.on_pose
        return topics

    def on_image(self, message: Any) -> None:
        stamp = stamp_of(message)
        if self._stamps.refuses(f"an image of {self.config.camera}", stamp) or self._too_large(message):
            return
        if stamp < self._newest and not self._join.known("image", stamp):
            self.health.note("out_of_order")
        self._newest = max(stamp, self._newest)
        self.health.gauge("newest_stamp", f"{self._newest / 1e9:.3f}")
        self._join.add("image", stamp, message)

    def on_camera_info(self, message: Any) -> None:
        if not self._too_many_pixels("camera_info", int(message.width), int(message.height)):
            self._join.add("calibration", stamp_of(message), msg_to_camera(message))

    def on_pose(self, message: Any) -> None:
        pose = msg_to_pose(message, "map")
        covariance = msg_to_covariance(message)
        if covariance is None and np.any(message.pose.covariance):
            self.health.note("unknown_covariance")
            covariance = msg_to_covariance(message, self._assumed)
        self._join.add("pose", stamp_of(message), (pose, covariance))

    def on_fix(self, message: Any) -> None:
        self._join.add("fix", stamp_of(message), msg_to_fix(message))

    def on_imu(self, message: Any) -> None:
        self._join.add("attitude", stamp_of(message), msg_to_attitude(message))

    def on_correction(self, message: Any) -> None:
        self._correction = msg_to_correction(message)

    def on_finished(self, message: Any) -> None:
        self._admission.finished(message.frame_id, time_to_ns(message.stamp))

    def idle(self) -> None:
        self._admission.idle(self.outlet.prompt_workers(FINISHED))

    def tick(self, waited: float) -> None:
        self._join.tick(waited)
        self._admission.tick(waited)

    def finish(self) -> None:
        self._join.finish()
        self._admission.finish()

    def _offer(
        self,
        image: Any,
        pose: tuple[Pose, Any] | None = None,
        calibration: Camera | None = None,
        fix: Fix | None = None,
        attitude: Attitude | None = None,
    ) -> None:
        where, covariance = (self._fixed_pose, self._fixed_covariance) if pose is None else pose
        if fix is not None and attitude is not None and self._sensors is not None and self._dem is not None:
            size = (int(image.width), int(image.height)) if self._raw else compressed_size(image)
            stamp = stamp_of(image)
            where, covariance = sensed_pose(fix, attitude, stamp, size, self._frame, self._dem, self._sensors)
        camera = self._fixed_calibration if calibration is None else calibration
        assert where is not None  # nosec B101 # tells the type checker what holds
        assert camera is not None  # nosec B101 # tells the type checker what holds
        # A JPEG or PNG whose first bytes say that it is not this camera's takes no other's place at the door.
        if self._raw or self._fits(image, camera):
            self._admission.offer(stamp_of(image), _Frame(image, where, covariance, camera))

    def _send(self, frame: _Frame) -> None:
        """Only here is an image decoded: what is turned away costs next to nothing."""
        stamp = stamp_of(frame.image)
        photo = msg_to_rgb(frame.image) if self._raw else compressed_to_rgb(frame.image)
        pose, covariance = frame.pose, frame.covariance
        if self._refines:
            self.outlet.publish(STATED_POSE, pose_to_msg(pose, stamp, "map", covariance))
        if self._correction is not None:
            pose, covariance = self._correction.applied(pose, self._assumed if covariance is None else covariance)
            self.health.note("pose_corrected" if self._correction.known else "pose_suspected")
        posed = PosedImage(photo, frame.camera, pose, stamp, self.config.camera)
        self.outlet.publish(POSED_CAMERA_INFO, camera_to_msg(posed.camera, stamp, self._frame_id))
        self.outlet.publish(POSED_POSE, pose_to_msg(posed.pose, stamp, "map", covariance))
        self.outlet.provide(POSED_IMAGE, stamp, lambda: image_to_msg(posed.image, "rgb8", stamp, self._frame_id))

    def _too_large(self, message: Any) -> bool:
        """Whether an image holds more than may wait here; the size that its first bytes state is looked at later."""
        if self._raw and self._too_many_pixels("image", int(message.width), int(message.height)):
            return True
        # Raw, the widest of the encodings that are taken has four bytes a pixel.
        size, most = len(message.data), 4 * self._limits.pixels if self._raw else self._limits.image_bytes
        if size > most:
            key = "pixels" if self._raw else "image_bytes"
            self._drop_large(f"image of {size} bytes, at most {most} are taken", key)
        return size > most

    def _too_many_pixels(self, what: str, width: int, height: int) -> bool:
        if width * height <= self._limits.pixels:
            return False
        self._drop_large(f"{what} of {width} x {height} pixels, at most {self._limits.pixels} are taken", "pixels")
        return True

    def _drop_large(self, what: str, key: str) -> None:
        self.health.drop("too_large", f"{what}; send less, or raise {key} under `limits:` in the site file")

    def _fits(self, image: Any, camera: Camera) -> bool:
        """Before an image is decoded: whether it is of a size that can be taken. Raises ImageError where the
        calibration is for another."""
        width, height = compressed_size(image)
        if self._too_many_pixels("image", width, height):
            return False
        if (width, height) != (camera.width, camera.height):
            raise ImageError(
                f"image of {self.config.camera} is {width} x {height} pixels, its calibration is for {camera.width} x "
                f"{camera.height}; publish a camera_info for the image as it is sent, or mend it in the site file"
            )
        return True

    def _give_up(self, stamp: int, lacking: list[str], why: str) -> None:
        name = next((part for part in ("pose", "fix", "attitude") if part in lacking), "calibration")
        cause = "no_calibration" if name == "calibration" else "no_pose"
        missing = {"calibration": "camera_info", "attitude": "imu"}.get(name, name)
        self.health.drop(cause, f"image of stamp {stamp} ns has no {missing} ({why}); publish one with its stamp")


NODE = NodeType("capture", CaptureConfig, Capture)


def main() -> None:
    run_node(NODE)


if __name__ == "__main__":
    main()
