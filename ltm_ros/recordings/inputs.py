"""Find the input topics of a site's cameras in a recording, check their types, and decode their messages."""

import logging
import math
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ltm_core.base.errors import LtmError, MessageError
from ltm_core.cameras.camera_config import PoseConfig
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, vector_of_matrix
from ltm_core.site.site import Site
from ltm_msgs_py.bag.cdr import TF_TYPE, header_of, transforms_of
from ltm_msgs_py.bag.reader import BagMessage, BagReader, TopicInfo, decoded
from ltm_msgs_py.bag.schemas import type_name_of
from ltm_msgs_py.pose import POSE_TYPES, as_stamped_pose, msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_ros.runtime.frame_join import CameraPoses
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.topics import (
    CAMERA_INFO,
    CAMERA_INPUTS,
    IMAGE_COMPRESSED,
    IMAGE_RAW,
    POSE,
    camera_topic,
    image_topics,
    input_topic,
    other_inputs,
    transform_topics,
)

_IMAGES = (IMAGE_COMPRESSED.type, IMAGE_RAW.type)
_log = logging.getLogger(__name__)


def accepted_types(topic: Topic) -> tuple[str, ...]:
    """Return the message types that are read from a recorded topic."""
    return POSE_TYPES if topic.type is POSE.type else (type_name_of(topic.type()),)


def decoded_input(topic: Topic, raw: bytes, type_name: str, encoding: str = "cdr") -> Any:
    """Return a recorded message as the topic's own type.

    Raises MessageError for another type, RecordingError for bytes that do not decode, PoseError for another frame's."""
    accepted = accepted_types(topic)
    if type_name not in accepted:
        raise MessageError(f"the type is {type_name or 'unknown'}; supported: {', '.join(accepted)}")
    message = decoded(raw, type_name, encoding)
    return as_stamped_pose(message) if topic.type is POSE.type else message


def recorded_inputs(site: Site, recorded: Mapping[str, TopicInfo]) -> dict[str, Topic]:
    """Return the input topics of a site's cameras in a recording, by absolute name, with one kind of images."""
    found: dict[str, Topic] = {}
    for camera, config in site.cameras.items():
        images = {camera_topic(site.name, camera, topic): topic for topic in image_topics(config)}
        present = [name for name in images if name in recorded]
        right = [name for name in present if recorded[name].type_name in accepted_types(images[name])]
        for name in sorted(right or present, key=lambda name: recorded[name].message_count == 0)[:1]:
            found[name] = images[name]
        needed = other_inputs(config)
        for topic in (input_topic(config, topic) for topic in CAMERA_INPUTS if topic.type not in _IMAGES):
            known = recorded.get(name := camera_topic(site.name, camera, topic))
            if known is not None and (topic in needed or known.type_name in accepted_types(topic)):
                found[name] = topic
    return found


@dataclass(frozen=True)
class _PoseSource:
    """Where a camera's pose comes from if it must be converted: `topic` of moving transforms (`moving`) or of stated
    poses, and `static` transforms. `pose`: topic of the poses made of them."""

    camera: str
    topic: str
    moving: bool
    static: str
    pose: str
    images: tuple[str, ...]


class InputReader:
    """The input messages of a site's cameras in a bag, as their nodes subscribe to them (`topics`, by absolute name).

    A pose in transforms, or of another frame that transforms lead on from, becomes the camera's own pose."""

    def __init__(self, reader: BagReader, site: Site) -> None:
        recorded = reader.topic_infos()
        self.reader = reader
        self.topics = recorded_inputs(site, recorded)
        self.sources: list[_PoseSource] = []
        """What is converted; the number of these messages is unknown."""
        for camera, config in site.cameras.items():
            pose = next((topic for topic in other_inputs(config) if topic.counted_name == POSE.name), None)
            if pose is None:
                continue
            stated, own = (camera_topic(site.name, camera, topic) for topic in (pose, POSE))
            moving, static = transform_topics(config)
            if moving or (static in recorded and stated in recorded):
                images = tuple(camera_topic(site.name, camera, topic) for topic in image_topics(config))
                source = _PoseSource(camera, moving or stated, bool(moving), static, own, images)
                self.sources.append(source)
        for source in self.sources:
            if not source.moving:
                self.topics.pop(source.topic, None)
        self.topics |= {source.pose: replace(POSE, counted=False) for source in self.sources}

    def messages(
        self, topics: Collection[str], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """Yield messages of some of `topics`, as `BagReader.messages`."""
        sources = [(source, self._camera_poses(source)) for source in self.sources if source.pose in topics]
        plain = set(topics) - {source.pose for source in self.sources}
        more = {name for s, _ in sources for name in (s.topic, *(s.images if s.moving else ()))}
        for message in self.reader.messages(plain | more, start_ns, end_ns):
            for source, poses in sources:
                yield from _converted(source, poses, message)
            if message.topic in plain:
                yield message
        for source, poses in sources:
            if source.moving and (missing := poses.missing()):
                _log.warning("%s: %s", source.camera, missing)

    def _camera_poses(self, source: _PoseSource) -> CameraPoses:
        """Return a camera's transforms with all static ones, also those before a replay's start."""
        first, frame = next(self.reader.messages(source.images), None), ""
        with suppress(LtmError):  # the image's reader counts it
            frame = header_of(first.raw)[1] if first else ""
        poses = CameraPoses(frame or f"{source.camera}_optical")
        for message in self.reader.messages([source.static]):
            try:
                deque(poses.of_transforms(transforms_of(message.raw), True), 0)
            except LtmError as error:
                _log.warning("%s at %s ns: %s", message.topic, message.log_time_ns, error)
        return poses


def _converted(source: _PoseSource, poses: CameraPoses, message: BagMessage) -> Iterator[BagMessage]:
    """Yield the camera's poses that follow from a message: transforms, a stated pose, or an image."""
    from rclpy.serialization import serialize_message  # who only reads topics need not load the middleware

    try:
        if message.topic == source.topic and source.moving:
            found = poses.of_transforms(transforms_of(message.raw), False)
        elif message.topic == source.topic and message.type_name not in POSE_TYPES:
            raise MessageError(message.type_name)
        elif message.topic == source.topic:
            found = poses.of_pose(decoded(message.raw, message.type_name, message.encoding))
        elif message.topic in source.images and source.moving:
            stamp, frame = header_of(message.raw)
            found = poses.of_image(frame, stamp)
        else:
            return
        times = message.log_time_ns, message.publish_time_ns
        for pose in found:
            yield BagMessage(source.pose, *times, type_name_of(pose), serialize_message(pose))
    except LtmError as error:
        if message.topic != source.topic:
            return  # the image's reader counts it
        if source.moving:
            _log.warning("%s at %s ns: %s", message.topic, message.log_time_ns, error)
        else:
            yield replace(message, topic=source.pose)  # as it is, for its reader to count


def is_image(topic: Topic) -> bool:
    return topic.type in _IMAGES


def beside_expected(site: Site, recorded: Mapping[str, str], cameras: Iterable[str] = ()) -> str:
    """Return the topics and types of a recording beside the expected ones, and the mapping to try, in words."""
    expected, mapping = [], []
    for camera in cameras or site.cameras:
        config = site.cameras[camera]
        proposed: dict[str, str] = {}
        moving, _ = transform_topics(config)
        converted = {camera_topic(site.name, camera, POSE): moving} if moving else {}
        for topics in (image_topics(config), *((topic,) for topic in other_inputs(config))):
            names = [camera_topic(site.name, camera, topic) for topic in topics]
            types = [accepted_types(topic) for topic in topics]
            if names[0] in converted:
                names, types = [converted[names[0]]], [(TF_TYPE,)]
            expected.append(" or ".join(f"{n} ({' or '.join(t)})" for n, t in zip(names, types, strict=True)))
            if not any(recorded.get(name) in of for name, of in zip(names, types, strict=True)):
                proposed |= _proposed(site, camera, topics, recorded)
        kind = ["image: auto"] if proposed.pop("auto", "") else []
        named = [f"topics: {{{', '.join(f'{key}: {name}' for key, name in proposed.items())}}}"] if proposed else []
        if entries := [*kind, *named]:
            mapping.append(f"{camera}: {{{', '.join(entries)}}}")
    has = ", ".join(f"{name} ({type_name or 'no type'})" for name, type_name in sorted(recorded.items())) or "(none)"
    hint = f"; to use these, write under `cameras:` in the site file: {', '.join(mapping)}" if mapping else ""
    return f"expected: {', '.join(expected)}; its topics are {has}{hint}"


def _proposed(site: Site, camera: str, topics: Sequence[Topic], recorded: Mapping[str, str]) -> dict[str, str]:
    """Return the recorded topic that may be meant, by its key of the site file; none without any."""
    image = is_image(topics[0])
    types = [name for topic in ((IMAGE_COMPRESSED, IMAGE_RAW) if image else topics) for name in accepted_types(topic)]
    types += [TF_TYPE] if topics[0].counted_name == POSE.name else []
    others = ((name, config) for name, config in site.cameras.items() if name != camera)
    taken = {
        camera_topic(site.name, n, t) for n, config in others for t in (*image_topics(config), *other_inputs(config))
    }
    fitting = (name for name, kind in recorded.items() if kind in types and name not in taken)
    found = [name for name in fitting if "depth" not in name.lower() and not name.endswith("_static")]
    if not found:
        return {}
    first = min(found, key=lambda name: (camera not in name.split("/"), name))
    usual = [camera_topic(site.name, camera, topic) for topic in (IMAGE_COMPRESSED, IMAGE_RAW)]
    if image and site.cameras[camera].image != "auto" and first in usual:
        return {"auto": first}
    return {"image" if image else topics[0].counted_name: first}


def warn_of_ignored(site: Site, first: Callable[[str, Topic], Any]) -> None:
    """Log which recorded poses and calibrations the site file overrides, and by how much they differ. `first`: returns
    the first message of a recorded topic, None without any; may raise LtmError."""
    for camera, config in site.cameras.items():
        for key, topic in (("pose", POSE), ("calibration", CAMERA_INFO)):
            if (stated := config.pose if key == "pose" else config.calibration) is None:
                continue
            try:
                message = first(camera_topic(site.name, camera, own := input_topic(config, topic)), own)
                if message is None:
                    continue
                ours = stated.pose(site.open_dem(), site.frame) if isinstance(stated, PoseConfig) else stated.camera()
                differs = _difference(ours, message)
            except LtmError as error:
                differs = f"the recorded one is invalid ({error})"
            if differs:
                _log.warning(
                    "%s: the %s of the site file is used, not the recording's: %s. To use the recording's, remove "
                    "cameras.%s.%s from the site file", camera, key, differs, camera, key,
                )  # fmt: skip


def _difference(ours: Pose | Camera, message: Any) -> str:
    """Return by how much the first recorded pose or calibration differs from the site file's; empty if it does not, or
    by less than 0.01 degrees and 1 cm."""
    if isinstance(ours, Camera):
        theirs = msg_to_camera(message)
        sizes = [f"{one.width} x {one.height} pixels with fx {one.fx:.1f}" for one in (theirs, ours)]
        return "" if ours == theirs else f"the first recorded one has {sizes[0]}, the site file's {sizes[1]}"
    pose = msg_to_pose(message, "map")
    degrees = math.degrees(float(np.linalg.norm(vector_of_matrix(ours.rotation.T @ pose.rotation))))
    metres = float(np.linalg.norm(ours.position - pose.position))
    differs = degrees >= 0.01 or metres >= 0.01
    return f"the first recorded one differs by {degrees:.2f} degrees and {metres:.2f} m" if differs else ""
