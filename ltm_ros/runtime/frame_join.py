"""Join a camera's images with their calibrations and poses; used live and for archives.

The node `capture` joins live messages, the archive joins recorded ones: the same frame has the same pose."""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from pydantic import Field

from ltm_core.base.errors import ImageError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import Float64Array
from ltm_core.cameras.sensor_pose import Attitude, Fix, sensed_pose
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, moved_covariance
from ltm_core.site.site import Site
from ltm_msgs_py.bag.schemas import type_name_of
from ltm_msgs_py.pose import as_stamped_pose, msg_to_covariance, msg_to_pose, msg_to_transform, pose_to_msg
from ltm_msgs_py.sensors import msg_to_attitude, msg_to_camera, msg_to_fix
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.stamp_join import MAX_GAP_NS, Match, Part, StampJoin
from ltm_ros.runtime.topics import CAMERA_INFO, FIX, IMU, POSE, camera_topic, image_topics, other_inputs

_FASTER = ", or with two stamps around it, at most 0.25 s apart; else set nodes.capture.pose_tolerance"


class FrameJoinConfig(StrictModel):
    pose_tolerance: float = Field(0.0, ge=0)
    """Maximum difference in seconds between a pose's stamp and its image's. 0: a pose of equal stamp, or two around it,
    at most 0.25 s apart, to interpolate between."""
    max_wait: float = Field(3.0, gt=0)
    """Seconds for which an image waits for its pose and calibration."""
    max_waiting: int = Field(20, ge=1)
    """Maximum number of images that wait for their pose and calibration; the oldest is dropped first."""
    drop_repeated: bool = False
    """Whether to drop an image with the bytes of the camera's previous one: a frozen image would count as new evidence
    for as long. Nodes `source` send none; set it for other drivers, and their recordings."""


@dataclass(frozen=True, eq=False)
class JoinedFrame:
    """An image with its pose, the pose's covariance (6, 6) (None: unknown) and its calibration."""

    image: Any
    pose: Pose
    covariance: Float64Array | None
    camera: Camera


class FrameJoin(StampJoin):
    """Joins an image (the part `image`) when its pose and a calibration have come; the newest calibration up to its
    stamp is used.

    Equal poses and calibrations of a fixed camera are stored as one object. Otherwise each frame would leave some
    twenty small blocks among those of images, freed a thousand frames later, which fragments the heap.

    Args: complete: takes each joined frame. health: counts duplicates, invalid covariances, and frames without a part
    (`no_pose`, `no_calibration`). stamp_and_size: of an image, nanoseconds and (width, height)."""

    def __init__(
        self,
        site: Site,
        name: str,
        config: FrameJoinConfig,
        complete: Callable[[JoinedFrame], None],
        health: Health,
        stamp_and_size: Callable[[Any], tuple[int, tuple[int, int]]],
    ) -> None:
        camera = site.camera(name)
        self._site_name, self._name, self._take = site.name, name, complete
        self._stamp_and_size, self._sensors, self._frame = stamp_and_size, camera.sensors, site.frame
        self.image_topics = image_topics(camera)
        self._other_inputs = other_inputs(camera)
        self._dem = site.open_dem() if camera.sensors is not None or camera.pose is not None else None
        self._calibration = camera.calibration.camera() if camera.calibration else None
        """The site's calibration, or the last one that came."""
        self._pose: _StatedPose | None = None
        """The site's pose, or the last one that came."""
        if camera.pose is not None and self._dem is not None:
            pose, assumed = camera.pose.pose(self._dem, site.frame), site.assumed_pose_error
            self._pose = pose, camera.pose.covariance(pose, assumed.position, assumed.angle_deg)
        self.assumed = site.assumed_pose_error.covariance()
        """Covariance (6, 6) of poses that state none."""
        needed = {
            FIX.name: Part(FIX.name, Match.LATEST),
            IMU.name: Part(IMU.name, Match.NEAREST, round(camera.sensors.attitude_age * 1e9) if camera.sensors else 0),
            POSE.name: Part(POSE.name, Match.NEAREST, round(config.pose_tolerance * 1e9), between=_between),
            CAMERA_INFO.name: Part(CAMERA_INFO.name, Match.LATEST),
        }
        super().__init__(
            [Part("image"), *(needed[topic.counted_name] for topic in self._other_inputs)],
            self._joined,
            health,
            config.max_waiting,
            max_wait=config.max_wait,
            give_up=self._count_lacking,
            capacity_bytes=site.limits.waiting_bytes,
        )

    @property
    def others(self) -> Mapping[Topic, Callable[[Any], None]]:
        """Return the other topics to join, by the site file, with their callbacks."""
        takes = {
            CAMERA_INFO.name: self.on_camera_info,
            POSE.name: self.on_pose,
            FIX.name: lambda message: self.add(FIX.name, stamp_of(message), msg_to_fix(message)),
            IMU.name: lambda message: self.add(IMU.name, stamp_of(message), msg_to_attitude(message)),
        }
        found = {topic: takes[topic.counted_name] for topic in self._other_inputs}
        if any(topic.any_pose for topic in found):  # replays send them, if transforms lead on from the named ones
            found[replace(POSE, counted=False)] = self.on_pose
        return found

    def check_size(self, size: tuple[int, int], camera: Camera) -> None:
        """Check the size of an image. Raises ImageError if a calibration has another size, (width, height)."""
        if size != (camera.width, camera.height):
            raise ImageError(
                f"image of {self._name} is {size[0]} x {size[1]} pixels, but its calibration is for "
                f"{camera.width} x {camera.height}; publish a matching camera_info, or correct the calibration in "
                "the site file"
            )

    def on_camera_info(self, message: Any) -> None:
        camera = msg_to_camera(message)
        if camera != self._calibration:
            self._calibration = camera
        self.add(CAMERA_INFO.name, stamp_of(message), self._calibration)

    def on_pose(self, message: Any) -> None:
        pose = msg_to_pose(message, "map")
        covariance = msg_to_covariance(message)
        if covariance is None and np.any(message.pose.covariance):
            self._health.note("unknown_covariance")
            covariance = msg_to_covariance(message, self.assumed)
        if self._pose is None or pose != self._pose[0] or not _equal(covariance, self._pose[1]):
            self._pose = pose, covariance
        self.add(POSE.name, stamp_of(message), self._pose)

    def _joined(
        self,
        image: Any,
        pose: "_StatedPose | None" = None,
        camera_info: Camera | None = None,
        fix: Fix | None = None,
        imu: Attitude | None = None,
    ) -> None:
        stated, camera = pose or self._pose, camera_info or self._calibration
        if fix is not None and imu is not None and self._sensors is not None and self._dem is not None:
            stamp, size = self._stamp_and_size(image)
            stated = sensed_pose(fix, imu, stamp, size, self._frame, self._dem, self._sensors)
        assert stated is not None  # nosec B101 # tells the type checker what holds
        assert camera is not None  # nosec B101 # tells the type checker what holds
        self._take(JoinedFrame(image, *stated, camera))

    def _count_lacking(self, stamp: int, lacking: list[str], why: str) -> None:
        poses_first = sorted(self._other_inputs, key=lambda topic: topic.counted_name == CAMERA_INFO.name)
        missing = next(topic for topic in poses_first if topic.counted_name in lacking)
        name = missing.counted_name
        what = f"{type_name_of(missing.type())} on {camera_topic(self._site_name, self._name, missing)}"
        self._health.drop(
            "no_calibration" if name == CAMERA_INFO.name else "no_pose",
            f"image of stamp {stamp} ns has no {name} ({why}); publish {what} with the image's "
            f"stamp{_FASTER if name == POSE.name else ''}",
        )


_StatedPose = tuple[Pose, Float64Array | None]


def _between(one: _StatedPose, other: _StatedPose, share: float) -> _StatedPose:
    """Interpolate two poses; the covariance is the larger one, unknown if either is."""
    (a, of_a), (b, of_b) = one, other
    return a.towards(b, share), None if of_a is None or of_b is None else max(of_a, of_b, key=np.trace)


def _equal(one: Float64Array | None, other: Float64Array | None) -> bool:
    return one is other if one is None or other is None else np.array_equal(one, other)


@dataclass
class _Edge:
    """The poses of a frame in its parent by stamp, ascending; static: one, which always holds."""

    parent: str
    static: bool
    stamps: list[int] = field(default_factory=list)
    poses: list[Pose] = field(default_factory=list)
    covariance: Float64Array | None = None

    def add(self, stamp: int, pose: Pose) -> None:
        if self.static or (self.stamps and stamp < self.stamps[-1] - _KEPT_NS):  # a clock was set back
            self.stamps, self.poses = [], []
        if not self.stamps or stamp > self.stamps[-1]:
            self.stamps.append(stamp)
            self.poses.append(pose)
        old = bisect_left(self.stamps, self.stamps[-1] - _KEPT_NS)
        del self.stamps[:old], self.poses[:old]

    def at(self, stamp: int) -> Pose | None:
        """Return the pose at a time; None if the stamps around it are more than `MAX_GAP_NS` apart."""
        n = 0 if self.static else bisect_left(self.stamps, stamp)
        if self.static or self.stamps[n : n + 1] == [stamp]:
            return self.poses[n]
        if not 0 < n < len(self.stamps) or self.stamps[n] - self.stamps[n - 1] > MAX_GAP_NS:
            return None
        share = (stamp - self.stamps[n - 1]) / (self.stamps[n] - self.stamps[n - 1])
        return self.poses[n - 1].towards(self.poses[n], share)


_KEPT_NS = 10_000_000_000
"""Time for which transforms are kept, as in tf2."""


class CameraPoses:
    """Follows chains of transforms from `map` to a camera's frame, and returns poses of that frame.

    Transforms of a chain may have different rates: there is a pose at each stamp of any of them, and the others are
    interpolated to it (`MAX_GAP_NS`). `frame`: the camera's frame, that of its images."""

    def __init__(self, frame: str = "") -> None:
        self.frame = frame
        self._edges: dict[str, _Edge] = {}
        self._done = -1

    def of_transforms(self, transforms: Iterable[Any], static: bool) -> Iterator[PoseWithCovarianceStamped]:
        """Take the transforms of a TFMessage; yield new poses. Raises PoseError for an invalid transform."""
        for one in transforms:
            edge = self._edge(one.header.frame_id, one.child_frame_id, static)
            edge.add(stamp_of(one), msg_to_transform(one))
        yield from self._new()

    def of_pose(self, msg: Any) -> Iterator[PoseWithCovarianceStamped]:
        """Take a message of `POSE_TYPES`; yield it as the camera's pose in `map`, by transforms if it is that of
        another frame, or in another. Raises PoseError for another frame's without transforms."""
        parent, child = msg.header.frame_id, getattr(msg, "child_frame_id", "") or self.frame
        if parent != "map" or not (child == self.frame or child.endswith("optical")):
            stated = as_stamped_pose(msg, any_frame=True)
            edge = self._edge(parent, child, False)
            edge.covariance = msg_to_covariance(stated)
            edge.add(stamp_of(stated), msg_to_pose(stated))
            if self._chain():
                yield from self._new()
                return
        yield as_stamped_pose(msg)

    def of_image(self, frame: str, stamp_ns: int) -> Iterator[PoseWithCovarianceStamped]:
        """Take the frame and stamp of an image; yield its pose if the whole chain is static."""
        self.frame = frame or self.frame
        chain = self._chain()
        if chain and all(edge.static for edge in chain) and (pose := _along(chain, stamp_ns)[0]) is not None:
            yield pose_to_msg(pose, stamp_ns)

    def missing(self) -> str:
        """Return why there is no pose, in words; empty if a chain is known."""
        if self._chain():
            return ""
        known = ", ".join(f"{edge.parent} -> {child}" for child, edge in sorted(self._edges.items())) or "none"
        return f"no chain of transforms leads from 'map' to the frame {self.frame!r} of its images; known: {known}"

    def _edge(self, parent: str, child: str, static: bool) -> _Edge:
        edge = self._edges.get(child)
        if edge is None or (edge.parent, edge.static) != (parent, static):
            edge = self._edges[child] = _Edge(parent, static)
        return edge

    def _chain(self) -> list[_Edge]:
        """Return the edges from `map` to the camera's frame; none if they are not connected."""
        chain: list[_Edge] = []
        frame = self.frame
        while frame != "map" and frame in self._edges and len(chain) < len(self._edges):
            chain.insert(0, self._edges[frame])
            frame = chain[0].parent
        return chain if frame == "map" else []

    def _new(self) -> Iterator[PoseWithCovarianceStamped]:
        chain = self._chain()
        moving = [edge for edge in chain if not edge.static]
        if not moving:
            return
        newest = min(edge.stamps[-1] for edge in moving)
        if newest < self._done - _KEPT_NS:
            self._done = -1
        for stamp in sorted({s for edge in moving for s in edge.stamps if self._done < s <= newest}):
            pose, covariance = _along(chain, stamp)
            if pose is not None:
                yield pose_to_msg(pose, stamp, covariance=covariance)
        self._done = max(self._done, newest)


def _along(chain: list[_Edge], stamp: int) -> tuple[Pose | None, Float64Array | None]:
    """Return the pose at the end of a chain, and its covariance if an edge states one."""
    pose = Pose(np.zeros(3), np.eye(3))
    stated: tuple[Float64Array, Float64Array] | None = None
    for edge in chain:
        if (step := edge.at(stamp)) is None:
            return None, None
        before, pose = pose, step.after(pose)
        if edge.covariance is not None:
            turn = np.kron(np.eye(2), before.rotation)
            stated = pose.position, turn @ edge.covariance @ turn.T
    return pose, None if stated is None else moved_covariance(stated[1], pose.position - stated[0])
