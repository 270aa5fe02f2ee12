"""capture: joins a camera's images, calibration and poses, checks them, and sends them on under one stamp."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import Field

from ltm_core.camera import Camera
from ltm_core.errors import LtmError
from ltm_core.frame import PosedImage
from ltm_core.pose import Pose
from ltm_core.site_io import load_site
from ltm_msgs_py.camera_info import camera_to_msg, msg_to_camera
from ltm_msgs_py.image import compressed_to_rgb, image_to_msg, msg_to_rgb
from ltm_msgs_py.pose import msg_to_pose, pose_to_msg
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.handler import Handler, NodeConfig, NodeType, Outlet
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.topics import (
    CAMERA_INFO,
    IMAGE_COMPRESSED,
    IMAGE_RAW,
    POSE,
    POSED_CAMERA_INFO,
    POSED_IMAGE,
    POSED_POSE,
)

REMEMBERED = 1000
"""Stamps and poses kept to recognise duplicates and to join late images."""


class CaptureConfig(NodeConfig):
    pose_tolerance: float = Field(0.0, ge=0)
    """Seconds by which a pose's stamp may miss its image's. 0: stamps must be equal."""
    max_wait: float = Field(3.0, gt=0)
    """Seconds that an image waits for its pose and calibration."""
    max_waiting: int = Field(20, ge=1)
    """Images that wait at most; beyond it the oldest is dropped."""


class Capture(Handler[CaptureConfig]):
    """An image leaves when its pose and a calibration are there; the newest calibration up to its stamp counts."""

    publications = (POSED_IMAGE, POSED_CAMERA_INFO, POSED_POSE)

    def __init__(self, config: CaptureConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = load_site(config.site)
        camera = site.camera(config.camera)
        self._raw = camera.image == "raw"
        self._frame_id = f"{config.camera}_optical"
        self._fixed_pose: Pose | None = None
        if camera.pose is not None:
            self._fixed_pose = camera.pose.pose(site.open_dem(), site.frame)
        self._fixed_calibration = camera.calibration.camera() if camera.calibration else None
        self._calibrations: OrderedDict[int, Camera] = OrderedDict()
        self._poses: OrderedDict[int, tuple[Pose, Any]] = OrderedDict()
        self._images: OrderedDict[int, tuple[Any, float]] = OrderedDict()
        self._seen: OrderedDict[int, None] = OrderedDict()
        self._newest = -1

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        topics: dict[Any, Callable[[Any], None]] = {IMAGE_RAW if self._raw else IMAGE_COMPRESSED: self.on_image}
        if self._fixed_calibration is None:
            topics[CAMERA_INFO] = self.on_camera_info
        if self._fixed_pose is None:
            topics[POSE] = self.on_pose
        return topics

    def on_image(self, message: Any) -> None:
        stamp = stamp_of(message)
        if stamp in self._seen:
            self.health.drop("duplicate", f"a second image of stamp {stamp} ns; stamps must be unique a camera")
            return
        _remember(self._seen, stamp, None)
        if stamp < self._newest:
            self.health.note("out_of_order")
        self._newest = max(stamp, self._newest)
        self._images[stamp] = (message, 0.0)
        self._send_ready()
        while len(self._images) > self.config.max_waiting:
            self._give_up(min(self._images), f"{self.config.max_waiting} later images wait too")

    def on_camera_info(self, message: Any) -> None:
        _remember(self._calibrations, stamp_of(message), msg_to_camera(message))
        self._send_ready()

    def on_pose(self, message: Any) -> None:
        pose = msg_to_pose(message, "map")
        _remember(self._poses, stamp_of(message), (pose, message.pose.covariance))
        self._send_ready()

    def tick(self, waited: float) -> None:
        for stamp, (message, since) in list(self._images.items()):
            if since + waited > self.config.max_wait:
                self._give_up(stamp, f"waited {self.config.max_wait} s")
            else:
                self._images[stamp] = (message, since + waited)

    def finish(self) -> None:
        for stamp in list(self._images):
            self._give_up(stamp, "the recording or the node ended")

    def _send_ready(self) -> None:
        """Raises the last of the errors of images that cannot be sent, when all that can be are."""
        errors = []
        for stamp in sorted(self._images):
            pose, calibration = self._pose_for(stamp), self._calibration_for(stamp)
            if pose is not None and calibration is not None:
                message, _ = self._images.pop(stamp)
                try:
                    self._send(message, stamp, calibration, *pose)
                except LtmError as error:
                    errors.append(error)
        for earlier in errors[:-1]:
            self.health.drop(cause_of(earlier), str(earlier))
        if errors:
            raise errors[-1]

    def _pose_for(self, stamp: int) -> tuple[Pose, Any] | None:
        if self._fixed_pose is not None:
            return self._fixed_pose, None
        if stamp in self._poses or not self._poses or self.config.pose_tolerance == 0:
            return self._poses.get(stamp)
        # A nearer pose may still be on its way until one from after the image has come.
        nearest = min(self._poses, key=lambda other: abs(other - stamp))
        settled = max(self._poses) >= stamp
        return self._poses[nearest] if settled and abs(nearest - stamp) <= self.config.pose_tolerance * 1e9 else None

    def _calibration_for(self, stamp: int) -> Camera | None:
        if self._fixed_calibration is not None or not self._calibrations:
            return self._fixed_calibration
        past = [other for other in self._calibrations if other <= stamp]
        return self._calibrations[max(past) if past else min(self._calibrations)]

    def _send(self, message: Any, stamp: int, calibration: Camera, pose: Pose, covariance: Any) -> None:
        image = msg_to_rgb(message) if self._raw else compressed_to_rgb(message)
        frame = PosedImage(image, calibration, pose, stamp, self.config.camera)
        self.outlet.publish(POSED_CAMERA_INFO, camera_to_msg(frame.camera, stamp, self._frame_id))
        matrix = None if covariance is None else covariance.reshape(6, 6)
        self.outlet.publish(POSED_POSE, pose_to_msg(frame.pose, stamp, "map", matrix))
        self.outlet.publish(POSED_IMAGE, image_to_msg(frame.image, "rgb8", stamp, self._frame_id))

    def _give_up(self, stamp: int, why: str) -> None:
        del self._images[stamp]
        cause = "no_pose" if self._pose_for(stamp) is None else "no_calibration"
        missing = "pose" if cause == "no_pose" else "camera_info"
        self.health.drop(cause, f"image of stamp {stamp} ns has no {missing} ({why}); publish one with its stamp")


def _remember(memory: OrderedDict[int, Any], stamp: int, value: Any) -> None:
    memory[stamp] = value
    if len(memory) > REMEMBERED:
        memory.popitem(last=False)


NODE = NodeType("capture", CaptureConfig, Capture)


def main() -> None:
    run_node(NODE)


if __name__ == "__main__":
    main()
