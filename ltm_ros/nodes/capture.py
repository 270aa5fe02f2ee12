"""capture: join a camera's images, calibrations and poses, check them, and admit frames to the camera's nodes under one
stamp, as many as these can process."""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from ltm_core.base.types import Float64Array
from ltm_core.pipeline.frame import PosedImage
from ltm_core.pose_estimation.mount.mount_model import PoseCorrection
from ltm_core.site.site_io import load_site
from ltm_msgs_py.image import compressed_size, compressed_to_rgb, image_to_msg, msg_to_rgb
from ltm_msgs_py.pose import link_transform, mount_transform, msgs_to_correction, pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg, place_to_fix
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime import topics
from ltm_ros.runtime.frame_join import CameraPoses, FrameJoin, FrameJoinConfig, JoinedFrame
from ltm_ros.runtime.handler import Handler, NodeConfig, NodeType, Outlet, Topic
from ltm_ros.runtime.health import Health, too_large, too_many_pixels
from ltm_ros.runtime.node import run_node
from ltm_ros.runtime.stamp_check import StampCheck
from ltm_ros.runtime.stamp_join import data_bytes
from ltm_ros.runtime.topics import TF, TF_STATIC, transform_topics

AHEAD_NS = 10**10
"""Nanoseconds by which a camera's clock may be ahead; nodes that store frames reject others."""


class CaptureConfig(NodeConfig, FrameJoinConfig):
    shed: bool = True
    """Whether older queued frames are dropped, so that only the newest waits. False, as in a replay: all wait in order,
    up to `waiting_bytes` of the site's limits."""


def _is_raw(image: Any) -> bool:
    return hasattr(image, "encoding")


class CaptureHandler(Handler[CaptureConfig]):
    """Publishes an image when it has a pose and a calibration (the newest up to its stamp); if the camera's nodes share
    its process, when they have finished the previous one."""

    publications: Sequence[Topic] = (topics.POSED_IMAGE, topics.POSED_CAMERA_INFO, topics.POSED_POSE, topics.POSED_FIX)

    def __init__(self, config: CaptureConfig, outlet: Outlet, health: Health) -> None:
        super().__init__(config, outlet, health)
        site = load_site(config.site)
        self._frame_id = f"{config.camera}_optical"
        self._limits, self._frame = site.limits, site.frame
        self._refines = site.refine_poses is not None
        if self._refines:
            self.publications = (*self.publications, topics.STATED_POSE)
        if TF is not None and TF_STATIC is not None:
            self.publications = (*self.publications, TF, TF_STATIC)
        self._own_inputs = site.camera(config.camera)
        self._poses, self._mounted = CameraPoses(self._frame_id), False
        self._correction: PoseCorrection | None = None
        self._correction_parts: dict[Topic, Any] = {}
        """Newest `pose/correction` and `pose/info`, which count when their stamps are equal."""
        self._stamps, self._digest = StampCheck(outlet.now_ns, health), b""
        self._join = FrameJoin(site, config.camera, config, self._offer, health, self._stamp_and_size)
        self._waiting: OrderedDict[int, JoinedFrame] = OrderedDict()
        """Frames that wait until the camera's nodes have finished the previous one."""
        self._newest = -1
        self._takes_raw = False

    @property
    def subscriptions(self) -> Mapping[Any, Callable[[Any], None]]:
        found = dict(self._join.others)
        named = self._own_inputs.topics.pose is not None
        by_transforms = False
        for topic in found:
            if topic.counted_name == topics.CAMERA_INFO.name:
                found[topic] = self.on_camera_info
            elif topic.counted_name == topics.POSE.name and named:
                found[topic] = lambda message: self._join_poses(self._poses.of_pose(message))
                by_transforms = True
        if by_transforms and TF is not None and TF_STATIC is not None:
            moving, static = transform_topics(self._own_inputs)
            found[replace(TF_STATIC, name=static)] = partial(self._on_transforms, static=True)
            if moving:
                found[replace(TF, name=moving)] = partial(self._on_transforms, static=False)
        corrections = (topics.POSE_CORRECTION, topics.POSE_INFO) if self._refines else ()
        found |= {topic: partial(self.on_correction, topic) for topic in corrections}
        return found | dict.fromkeys(self._join.image_topics, self.on_image)

    def on_image(self, message: Any) -> None:
        stamp = stamp_of(message)
        raw = _is_raw(message)
        size = (int(message.width), int(message.height)) if raw else None  # of a compressed one it is read later
        if self._stamps.refuses(f"an image of {self.config.camera}", stamp) or too_large(
            self.health, self._limits, raw, len(message.data), size
        ):
            return
        known = self._join.known("image", stamp)
        if known and raw != self._takes_raw:
            self.health.note("other_image_topic")  # a driver that publishes both kinds
            return
        self._takes_raw = raw
        if stamp < self._newest and not known:
            self.health.note("out_of_order")
        # A frame from the future, before the clock was set back, would count as newest for as long.
        now = self.outlet.now_ns()
        ahead = now > 0 and self._newest > now + AHEAD_NS
        self._newest = stamp if ahead else max(stamp, self._newest)
        self.health.gauge("newest_stamp", f"{self._newest / 1e9:.3f}")
        if self.config.drop_repeated and not known:
            last, self._digest = self._digest, hashlib.blake2b(message.data).digest()
            if last == self._digest:
                why = f"an image of {self.config.camera} repeats the previous one; restart the camera if it is frozen"
                self.health.drop("repeated", why)
                return
        self._join_poses(self._poses.of_image(message.header.frame_id, stamp))
        self._join.add("image", stamp, message)

    def _on_transforms(self, message: Any, static: bool) -> None:
        self._join_poses(self._poses.of_transforms(message.transforms, static))

    def _join_poses(self, poses: Iterable[Any]) -> None:
        for pose in poses:
            self._join.on_pose(pose)

    def on_camera_info(self, message: Any) -> None:
        size = int(message.width), int(message.height)
        if not too_many_pixels(self.health, "camera_info", *size, self._limits.pixels):
            self._join.on_camera_info(message)

    def on_correction(self, topic: Topic, message: Any) -> None:
        parts = self._correction_parts = self._correction_parts | {topic: message}
        if len(parts) == 2 and len({stamp_of(part) for part in parts.values()}) == 1:
            self._correction = msgs_to_correction(parts[topics.POSE_CORRECTION], parts[topics.POSE_INFO])

    def idle(self) -> None:
        """Admit one frame, now that no further ones follow at once."""
        if self._waiting:
            _, frame = self._waiting.popitem(last=False)
            self.health.gauge("waiting", len(self._waiting))
            self._send(frame)

    def tick(self, waited: float) -> None:
        self._join.tick(waited)

    def finish(self) -> None:
        self._join.finish()
        for stamp in list(self._waiting):
            self._shed(stamp, "the node ended")
        self.health.gauge("waiting", 0)

    def _stamp_and_size(self, image: Any) -> tuple[int, tuple[int, int]]:
        return stamp_of(image), (int(image.width), int(image.height)) if _is_raw(image) else compressed_size(image)

    def _offer(self, frame: JoinedFrame) -> None:
        if not _is_raw(frame.image):  # one of the wrong size, by its first bytes, takes no place in the queue
            size = compressed_size(frame.image)
            if too_many_pixels(self.health, "image", *size, self._limits.pixels):
                return
            self._join.check_size(size, frame.camera)
        if not self.outlet.more_waits():
            self._send(frame)
            return
        self._waiting[stamp_of(frame.image)] = frame
        while len(self._waiting) > 1:
            held = sum(data_bytes(waiting.image) for waiting in self._waiting.values())
            if self.config.shed:
                self._shed(min(self._waiting), "a newer one is queued; reduce the frame rate or add cores")
            elif held > self._limits.waiting_bytes:
                self._shed(next(iter(self._waiting)), f"{held >> 20} MB are queued; reduce the frame rate or add cores")
            else:
                break
        self.health.gauge("waiting", len(self._waiting))

    def _shed(self, stamp: int, why: str) -> None:
        del self._waiting[stamp]
        self.health.drop("shed", f"the frame of stamp {stamp} ns: {why}")

    def _publish_frames(self, posed: Any) -> None:
        """Publish the camera's frames for RViz and Foxglove, if anything listens; recorders write them themselves."""
        if TF is None or TF_STATIC is None or not self.outlet.wanted(TF):
            return
        camera = self.config.camera
        if not self._mounted:
            self._mounted = True
            self.outlet.publish(TF_STATIC, TF_STATIC.type(transforms=[mount_transform(camera)]))
        stamp = stamp_of(posed)
        self.outlet.provide(TF, stamp, lambda: TF.type(transforms=[link_transform(camera, posed)]))

    def _send(self, frame: JoinedFrame) -> None:
        """Publish a frame. Images are decoded only here, so rejected ones cost almost nothing."""
        stamp = stamp_of(frame.image)
        photo = msg_to_rgb(frame.image) if _is_raw(frame.image) else compressed_to_rgb(frame.image)
        pose, covariance = frame.pose, frame.covariance
        if self._refines:
            self.outlet.publish(topics.STATED_POSE, pose_to_msg(pose, stamp, "map", covariance))
        if self._correction is not None:
            pose, covariance = self._correction.applied(pose, self._join.assumed if covariance is None else covariance)
            self.health.note("pose_corrected" if self._correction.known else "pose_suspected")
        posed = PosedImage(photo, frame.camera, pose, stamp, self.config.camera)
        self.outlet.publish(topics.POSED_CAMERA_INFO, camera_to_msg(posed.camera, stamp, self._frame_id))
        sent = pose_to_msg(posed.pose, stamp, "map", covariance)
        self.outlet.publish(topics.POSED_POSE, sent)
        self._publish_frames(sent)
        self.outlet.provide(topics.POSED_FIX, stamp, partial(self._fix, posed, covariance))
        self.outlet.provide(topics.POSED_IMAGE, stamp, lambda: image_to_msg(posed.image, "rgb8", stamp, self._frame_id))

    def _fix(self, posed: PosedImage, covariance: Float64Array | None) -> Any:
        """Return a frame's place for maps."""
        lon, lat = self._frame.to_lonlat(*posed.pose.position[:2])
        known = self._join.assumed if covariance is None else covariance
        return place_to_fix(float(lon), float(lat), known[:2, :2], posed.stamp_ns, self._frame_id)


NODE = NodeType("capture", CaptureConfig, CaptureHandler)
run_node(NODE, __name__)
