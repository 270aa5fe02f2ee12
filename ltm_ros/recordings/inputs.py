"""Find the input topics of a site's cameras in a recording, check their types, and decode their messages."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from ltm_core.base.errors import LtmError, MessageError
from ltm_core.geometry.pose import Pose
from ltm_core.site.sections import CameraConfig
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

    Raises MessageError for another type, RecordingError for bytes that do not decode, PoseError for odometry of another
    frame than a camera's."""
    accepted = accepted_types(topic)
    if type_name not in accepted:
        raise MessageError(f"the type is {type_name or 'unknown'}; supported: {', '.join(accepted)}")
    message = decoded(raw, type_name, encoding)
    return as_stamped_pose(message) if topic.type is POSE.type else message


def recorded_inputs(site: Site, recorded: Mapping[str, TopicInfo]) -> dict[str, Topic]:
    """Return the input topics of a site's cameras in a recording, by absolute name. Of a camera's two kinds of images,
    only the preferred one is taken."""
    found: dict[str, Topic] = {}
    for camera, config in site.cameras.items():
        images = {camera_topic(site.name, camera, topic): topic for topic in image_topics(config)}
        present = [name for name in images if name in recorded]
        right = [name for name in present if recorded[name].type_name in accepted_types(images[name])]
        for name in sorted(right or present, key=lambda name: recorded[name].message_count == 0)[:1]:
            found[name] = images[name]
        others = (input_topic(config, topic) for topic in CAMERA_INPUTS if topic.type not in _IMAGES)
        named = {camera_topic(site.name, camera, topic): topic for topic in others}
        needed = other_inputs(config)
        for name, topic in named.items():
            if name in recorded and (topic in needed or recorded[name].type_name in accepted_types(topic)):
                found[name] = topic
    return found


class InputReader:
    """The input messages of a site's cameras in a bag, as their nodes subscribe to them (`topics`, by absolute name).

    A pose in transforms, or of another frame that transforms lead on from, becomes the camera's own pose."""

    def __init__(self, reader: BagReader, site: Site) -> None:
        recorded = reader.topic_infos()
        self.reader, self._site_name = reader, site.name
        self.topics = recorded_inputs(site, recorded)
        self._images = {
            camera: [camera_topic(site.name, camera, topic) for topic in image_topics(config)]
            for camera, config in site.cameras.items()
        }
        self._moving: dict[str, str] = {}
        self._static: dict[str, str] = {}
        self._stated: dict[str, str] = {}
        self._poses: dict[str, str] = {}
        """Topics of moving and static transforms, of stated poses, and of the poses made of them, by camera."""
        for camera, config in site.cameras.items():
            pose = next((topic for topic in other_inputs(config) if topic.counted_name == POSE.name), None)
            moving, static = transform_topics(config)
            if pose is None:
                continue
            stated = camera_topic(site.name, camera, pose)
            if moving:
                self._moving[camera] = moving
            elif static in recorded and stated in recorded:
                self._stated[camera] = stated
            else:
                continue
            self._static[camera], self._poses[camera] = static, camera_topic(site.name, camera, POSE)
        for stated in self._stated.values():
            self.topics.pop(stated, None)
        self.topics |= dict.fromkeys(self._poses.values(), replace(POSE, counted=False))

    @property
    def converts(self) -> bool:
        """Return whether messages are converted, so that their number is unknown."""
        return bool(self._poses)

    def messages(
        self, topics: Collection[str], start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """Yield messages of some of `topics`, as `BagReader.messages`."""
        poses = {camera: self._camera_poses(camera) for camera, name in self._poses.items() if name in topics}
        images = {name: camera for camera in poses if camera in self._moving for name in self._images[camera]}
        sources = {
            topics_of[camera] for topics_of in (self._moving, self._stated) for camera in poses.keys() & topics_of
        }
        plain = set(topics) - {*self._poses.values()}
        for message in self.reader.messages(plain | sources | images.keys(), start_ns, end_ns):
            for camera, followed in poses.items():
                if self._moving.get(camera) == message.topic:
                    yield from _transformed(followed, self._poses[camera], message)
                elif self._stated.get(camera) == message.topic:
                    yield from _converted(followed, self._poses[camera], message)
            if message.topic in images:
                camera = images[message.topic]
                yield from _at_image(poses[camera], self._poses[camera], message)
            if message.topic in plain:
                yield message
        for camera in poses.keys() & self._moving.keys():
            if missing := poses[camera].missing():
                _log.warning("%s: %s", camera, missing)

    def _camera_poses(self, camera: str) -> CameraPoses:
        """Return a camera's transforms with all static ones, also those before a replay's start."""
        first, frame = next(self.reader.messages(self._images[camera]), None), ""
        with suppress(LtmError):  # the image's reader counts it
            frame = header_of(first.raw)[1] if first else ""
        poses = CameraPoses(frame or f"{camera}_optical")
        for message in self.reader.messages([self._static[camera]]):
            for _ in _transformed(poses, "", message, static=True):
                pass
        return poses


def _transformed(poses: CameraPoses, name: str, message: BagMessage, static: bool = False) -> Iterator[BagMessage]:
    try:
        for pose in poses.of_transforms(transforms_of(message.raw), static):
            yield _pose_message(name, message, pose)
    except LtmError as error:
        _log.warning("%s at %s ns: %s", message.topic, message.log_time_ns, error)


def _converted(poses: CameraPoses, name: str, message: BagMessage) -> Iterator[BagMessage]:
    """Yield a recorded pose as the camera's; an invalid one as it is, for its reader to count."""
    try:
        if message.type_name not in POSE_TYPES:
            raise MessageError(message.type_name)
        for pose in poses.of_pose(decoded(message.raw, message.type_name, message.encoding)):
            yield _pose_message(name, message, pose)
    except LtmError:
        yield replace(message, topic=name)


def _at_image(poses: CameraPoses, name: str, message: BagMessage) -> Iterator[BagMessage]:
    try:
        stamp, frame = header_of(message.raw)
        for pose in poses.of_image(frame, stamp):
            yield _pose_message(name, message, pose)
    except LtmError:
        return  # the image's reader counts it


def _pose_message(name: str, source: BagMessage, pose: Any) -> BagMessage:
    from rclpy.serialization import serialize_message  # who only reads topics need not load the middleware

    return BagMessage(name, source.log_time_ns, source.publish_time_ns, type_name_of(pose), serialize_message(pose))


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
    taken = {camera_topic(site.name, name, topic) for name, config in site.cameras.items() if name != camera
             for topic in (*image_topics(config), *other_inputs(config))}  # fmt: skip
    found = [name for name in sorted(recorded, key=lambda n: (camera not in n.split("/"), n))
             if recorded[name] in types and name not in taken and "depth" not in name.lower()
             and not name.endswith("_static")]  # fmt: skip
    if not found:
        return {}
    usual = [camera_topic(site.name, camera, topic) for topic in (IMAGE_COMPRESSED, IMAGE_RAW)]
    if image and site.cameras[camera].image != "auto" and found[0] in usual:
        return {"auto": found[0]}
    return {"image" if image else topics[0].counted_name: found[0]}


def warn_of_ignored(site: Site, first: Callable[[str, Topic], Any]) -> None:
    """Log which recorded poses and calibrations the site file overrides, and by how much they differ. `first`: returns
    the first message of a recorded topic, None without any; may raise LtmError."""
    for camera, config in site.cameras.items():
        for key, topic in (("pose", POSE), ("calibration", CAMERA_INFO)):
            if getattr(config, key) is None:
                continue
            try:
                message = first(camera_topic(site.name, camera, own := input_topic(config, topic)), own)
                differs = "" if message is None else _difference(site, config, key, message)
            except LtmError as error:
                differs = f"the recorded one is invalid ({error})"
            if differs:
                _log.warning(
                    "%s: the %s of the site file is used, not the recording's: %s. To use the recording's, remove "
                    "cameras.%s.%s from the site file", camera, key, differs, camera, key,
                )  # fmt: skip


def _difference(site: Site, config: CameraConfig, key: str, message: Any) -> str:
    """Return by how much the first recorded pose or calibration differs from the site file's; empty if it does not."""
    if key == "calibration" and config.calibration is not None:
        ours, theirs = config.calibration.camera(), msg_to_camera(message)
        if ours == theirs:
            return ""
        sizes = [f"{one.width} x {one.height} pixels with fx {one.fx:.1f}" for one in (theirs, ours)]
        return f"the first recorded one has {sizes[0]}, the site file's {sizes[1]}"
    assert config.pose is not None  # nosec B101 # tells the type checker what holds
    return pose_difference(config.pose.pose(site.open_dem(), site.frame), msg_to_pose(message, "map"))


def pose_difference(ours: Pose, theirs: Pose) -> str:
    """Return the angle and the distance between two poses in words; empty below 0.01 degrees and 1 cm."""
    cosine = (float(np.trace(ours.rotation.T @ theirs.rotation)) - 1) / 2
    degrees = math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
    metres = float(np.linalg.norm(ours.position - theirs.position))
    if degrees < 0.01 and metres < 0.01:
        return ""
    return f"the first recorded one differs by {degrees:.2f} degrees and {metres:.2f} m"
