"""The cameras of the site: frames of known content at a steady pace, by clocks that can be set wrong."""

import threading
import time
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from rclpy.node import Node
from scenes.small_site import NAME, Frame, SmallSite

from ltm_msgs_py.image import compressed_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.topics import CAMERA_INFO, IMAGE_COMPRESSED, IMAGE_RAW, POSE, camera_topic

CAMERAS = ("tower", "mast")
PHASES = 9
"""Frames of each camera that differ; then they come again."""


@dataclass(frozen=True)
class Sent:
    """One frame that a camera has sent. `at`: monotonic seconds."""

    camera: str
    phase: int
    stamp_ns: int
    at: float


class Photos:
    """What the cameras see in each phase."""

    def __init__(self, small: SmallSite) -> None:
        self._small = small

    @cached_property
    def _frames(self) -> dict[tuple[str, int], tuple[Frame, Any]]:
        frames = self._small.frames(PHASES)
        photos = {"mast": self._small.photo(frames[1])}  # stands still
        found = {}
        for number, frame in enumerate(frames):
            photo = photos.get(frame.camera_name)
            seen = self._small.photo(frame) if photo is None else photo
            content = seen if frame.camera_name == "mast" else encode_rgb(seen, quality=95)
            found[frame.camera_name, number // len(CAMERAS)] = frame, content
        return found

    def messages(self, camera: str, phase: int, stamp_ns: int) -> dict[Topic, Any]:
        """A frame's messages by topic, in the order in which the camera sends them."""
        frame, content = self._frames[camera, phase]
        optical = f"{camera}_optical"
        if camera == "mast":
            return {IMAGE_RAW: image_to_msg(content, "rgb8", stamp_ns, optical)}
        return {
            CAMERA_INFO: camera_to_msg(frame.camera, stamp_ns, optical),
            POSE: pose_to_msg(frame.pose, stamp_ns),
            IMAGE_COMPRESSED: compressed_to_msg(content, "jpeg", stamp_ns, optical),
        }


class Cameras:
    """Sends a frame of each camera every `period_s`, one camera after the other, from `start` to `stop`.

    No two frames bear the same stamp, whatever the clocks say: an update of the map names its frame by the stamp alone.
    """

    def __init__(self, node: Node, photos: Photos, period_s: float) -> None:
        self.sent: list[Sent] = []
        self.clock_error_s = dict.fromkeys(CAMERAS, 0.0)
        """By how much each camera's clock is ahead of the machine's."""
        self.unknown_covariance = False
        """Whether the tower's poses come with covariances of the greatest double, as some drivers say "unknown"."""
        self.period_s = period_s
        self._photos = photos
        self._publishers: dict[tuple[str, Topic], Any] = {}
        for camera in CAMERAS:
            for topic in photos.messages(camera, 0, 0):
                name = camera_topic(NAME, camera, topic)
                self._publishers[camera, topic] = node.create_publisher(topic.type, name, stream_qos())
        self._stamps: set[int] = set()
        self._lock = threading.Lock()
        self._numbers = dict.fromkeys(CAMERAS, 0)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="cameras", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join()

    def send(self, camera: str) -> Sent:
        """One more frame, now."""
        with self._lock:
            stamp = time.time_ns() + round(self.clock_error_s[camera] * 1e9)
            while stamp in self._stamps:
                stamp += 1
            self._stamps.add(stamp)
            phase = self._numbers[camera] % PHASES
            self._numbers[camera] += 1
            sent = Sent(camera, phase, stamp, time.monotonic())
            self.sent.append(sent)
            self._publish(sent)
            return sent

    def sent_of(self, camera: str) -> list[Sent]:
        """The frames of one camera by now, in the order of sending."""
        with self._lock:
            return [frame for frame in self.sent if frame.camera == camera]

    def repeat(self, sent: Sent) -> None:
        """A frame that was sent before, once more."""
        with self._lock:
            self._publish(sent)

    def _publish(self, sent: Sent) -> None:
        for topic, message in self._photos.messages(sent.camera, sent.phase, sent.stamp_ns).items():
            if topic is POSE and self.unknown_covariance:
                message.pose.covariance = np.full(36, np.finfo(float).max)
            self._publishers[sent.camera, topic].publish(message)

    def _run(self) -> None:
        gap = self.period_s / len(CAMERAS)
        due = time.monotonic()
        while not self._stopping.is_set():
            for camera in CAMERAS:
                self.send(camera)
                due += gap
                self._stopping.wait(max(0.0, due - time.monotonic()))
