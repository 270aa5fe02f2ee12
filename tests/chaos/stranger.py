"""Somebody in the graph who sends what no camera should: `python -m chaos.stranger ATTACK CAMERA SECONDS SEED`.

A process of its own, so that it comes and goes as strangers do. It says how many messages it sent. None of them makes a
whole frame that a node could take: whoever is inside the graph can send such in a camera's name, and no node can tell
(`ltm_lab/records/2026-11-security.md`).
"""

from __future__ import annotations

import io
import random
import sys
import time
from array import array
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Point32
from PIL import Image as Picture
from rclpy.node import Node
from rclpy.serialization import serialize_message
from scenes.small_site import MAST, NAME, TOWER

from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.vision.labels import LabelSet
from ltm_msgs_py.image import image_to_msg
from ltm_msgs_py.pointcloud import votes_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_msgs_py.stamp import make_header, ns_to_time
from ltm_ros.runtime import topics
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.ros_environment import limit_shutdown

LARGE = 60_000_000
"""Bytes of a message that is too large."""
VAST = (10_264, 7_700)
"""Width and height of a picture of 79 megapixels."""
LISTENED_S = 0.5
"""For a topic's listeners to be found; some have none, and that is right."""
GREATEST = sys.float_info.max
IMAGE_TOPICS = (
    *(
        topics.POSED_IMAGE,
        topics.DEPTH_IMAGE,
        topics.LABELS_IMAGE,
        topics.LABELS_CONFIDENCE,
        topics.MEASURED_DEPTH,
        topics.MEASURED_SIGMA,
    ),
    *(topics.FUSED_DEPTH, topics.NETWORK_DEPTH),
)
CALIBRATIONS = (topics.CAMERA_INFO, topics.POSED_CAMERA_INFO, topics.DEPTH_CAMERA_INFO)
POSES = (topics.POSE, topics.POSED_POSE)
SITE_TOPICS = (topics.FUEL_MAP_QUERY, topics.FUEL_MAP_REGION, topics.TERRAIN_CHANGE, topics.TERRAIN_UPDATE)

Messages = Iterator[tuple[Topic, Any]]
"""With the topic that each is for; bytes stand for a message that they may or may not be."""


class Stranger:
    """Makes hostile messages for the topics of one camera."""

    def __init__(self, camera: str, rng: random.Random) -> None:
        self.camera, self.rng = camera, rng
        self.input = topics.IMAGE_RAW if camera == "mast" else topics.IMAGE_COMPRESSED
        self._lens = MAST if camera == "mast" else TOWER
        self._labels = LabelSet.load().names
        self._numbers = np.random.default_rng(rng.randrange(2**32))

    def stamp(self) -> int:
        """One of its own: a little late, and no frame's."""
        return time.time_ns() - self.rng.randrange(10**6, 10**9)

    @property
    def _optical(self) -> str:
        return f"{self.camera}_optical"

    def _pose(self, stamp: int) -> Any:
        return pose_to_msg(Pose.from_angles((560.0, 470.0, 400.0), 20.0, -14.0, 1.5), stamp)

    def vast_pictures(self) -> Messages:
        """79 megapixels in few bytes, with pose and calibration; and raw ones that only say that they are as large."""
        for form in ("JPEG", "PNG"):
            file = io.BytesIO()
            Picture.new("L", VAST).save(file, form)
            stamp = self.stamp()
            yield topics.POSE, self._pose(stamp)
            yield topics.CAMERA_INFO, camera_to_msg(self._lens, stamp, self._optical)
            yield topics.IMAGE_COMPRESSED, self._compressed(file.getvalue(), stamp, form.lower())
        for topic in (topics.IMAGE_RAW, *IMAGE_TOPICS):
            message = image_to_msg(np.zeros((3, 4, 3), np.uint8), "rgb8", self.stamp(), self._optical)
            message.width, message.height = VAST
            message.step = 3 * VAST[0]
            yield topic, message

    def large_messages(self) -> Messages:
        """60 MB each, without a pose."""
        picture = np.zeros((4000, 5000, 3), np.uint8)
        compressed = self._compressed(bytes(LARGE), 0)
        raw = image_to_msg(picture, "rgb8", 0, self._optical)
        for topic in (self.input, *IMAGE_TOPICS):
            message = compressed if topic is topics.IMAGE_COMPRESSED else raw
            message.header.stamp = ns_to_time(self.stamp())
            for _ in range(3 if topic is self.input else 1):
                yield topic, message
        votes = self._votes(self.stamp(), 1)
        votes.data = array("B", bytes(LARGE))
        votes.width, votes.row_step = LARGE // votes.point_step, LARGE
        yield topics.FUEL_VOTES, votes

    def vast_calibrations(self) -> Messages:
        """12,000 x 9,000 pixels, with a pose of the same stamp: the depth of them would take 5 GB."""
        for topic in CALIBRATIONS:
            stamp = self.stamp()
            pose = topics.POSED_POSE if topic is topics.POSED_CAMERA_INFO else topics.POSE
            yield pose, self._pose(stamp)
            yield topic, camera_to_msg(Camera.from_fov(12_000, 9_000, 62.0), stamp, self._optical)

    def impossible_poses(self) -> Messages:
        """NaN, infinite, no rotation, another frame; covariances of the greatest double, NaN, negative, lopsided."""
        bad_covariances = (
            np.diag([float("nan")] * 6),
            -np.eye(6),
            np.eye(6) + 9.0 * np.eye(6, k=1),
            np.full((6, 6), 2.0),
            np.diag([float("inf")] * 6) * np.where(np.eye(6) > 0, -1, 0),
        )
        for topic in POSES:
            for place in (float("nan"), float("inf"), -GREATEST):
                message = self._pose(self.stamp())
                message.pose.pose.position.x = message.pose.pose.position.z = place
                yield topic, message
            message = self._pose(self.stamp())
            message.pose.pose.orientation.w = float("nan")
            yield topic, message
            message = self._pose(self.stamp())
            message.header.frame_id = "odom"
            yield topic, message
            for covariance in (np.full((6, 6), GREATEST), np.diag([GREATEST] * 6), *bad_covariances):
                message = self._pose(self.stamp())
                message.pose.covariance = np.asarray(covariance, float).ravel()
                yield topic, message

    def forged_votes(self) -> Messages:
        """Votes of clocks that are wrong, empty ones, of no camera's grid: thousands that shall push nothing out."""
        now = time.time_ns()
        for number in range(2000):
            yield topics.FUEL_VOTES, self._votes(now + 600 * 10**9 + number, number % 2)
        for year in (0, 1, 50 * 365):
            yield topics.FUEL_VOTES, self._votes(year * 86_400 * 10**9, 1)
        yield topics.FUEL_VOTES, self._votes(now - 30 * 86_400 * 10**9, 1)
        yield topics.FUEL_VOTES, self._votes(2**31 * 10**9 - 1, 1)
        for _ in range(50):
            yield topics.FUEL_VOTES, self._votes(self.stamp(), 0)
            yield topics.FUEL_VOTES, self._votes(self.stamp(), 1, shift=17.0)

    def hostile_strings(self) -> Messages:
        """Bytes that are no text, names that are paths, a megabyte of name, numbers in place of encodings."""
        names = ("../../etc/passwd", "A" * 1_000_000, "\u202e{}%s%n", "map\nmap", "")
        for topic in (*CALIBRATIONS, *POSES, *IMAGE_TOPICS, self.input, topics.FUEL_VOTES):
            for name in names:
                message = self._any(topic)
                message.header.frame_id = name
                yield topic, message
            spoilt = self._any(topic)
            spoilt.header.frame_id = "_optical_optical"
            yield topic, serialize_message(spoilt).replace(b"_optical_optical", b"\xff" * 16)
        for topic in (*IMAGE_TOPICS, topics.IMAGE_RAW):
            for encoding in ("bayer_rggb8", "../rgb8", "8" * 100_000, "32FC9999"):
                message = self._any(topic)
                message.encoding = encoding
                yield topic, message
        for text in ("{", '{"a":' * 5000, "\u0000", "[" * 100_000, '{"crs": 7}'):
            yield topics.LABELS_INFO, topics.LABELS_INFO.type(data=text)

    def noise(self) -> Messages:
        """Messages with bytes changed at random, cut short, or none at all, on every topic."""
        for topic in (*CALIBRATIONS, *POSES, *IMAGE_TOPICS, self.input, topics.FUEL_VOTES):
            whole = bytearray(serialize_message(self._any(topic)))
            yield topic, b"\x00\x01\x00\x00" + self.rng.randbytes(60)
            yield topic, bytes(whole[: len(whole) // 2])
            for _ in range(10):
                spoilt = bytearray(whole)
                for _ in range(4):
                    # Not the stamp, which might then be a frame's, nor what makes it a message of CDR.
                    spoilt[self.rng.randrange(12, len(spoilt))] = self.rng.randrange(256)
                yield topic, bytes(spoilt)

    def site_topics(self) -> Messages:
        """What the site's nodes take besides: questions, regions, changes of the surface."""
        for x, frame in ((float("nan"), "map"), (1e300, "map"), (-1.0, "map"), (5.0, "odom")):
            message = topics.FUEL_MAP_QUERY.type()
            message.header.frame_id = frame
            message.point.x = message.point.y = x
            yield topics.FUEL_MAP_QUERY, message
        for corners in (0, 2, 50_000):
            region = topics.FUEL_MAP_REGION.type()
            region.header.frame_id = "map"
            region.polygon.points = [
                Point32(x=float(n % 97), y=float("nan") if n == 3 else 1.0) for n in range(corners)
            ]
            yield topics.FUEL_MAP_REGION, region
        for width, height, ahead in ((2**31, 2**31, 0), (7, 5, 0), (7, 5, 3600), (0, 0, 0)):
            change = topics.TERRAIN_CHANGE.type()
            change.header.frame_id = "map"
            change.header.stamp = ns_to_time(self.stamp() + ahead * 10**9)
            change.info.width, change.info.height, change.info.resolution = width, height, 3.3
            change.data = array("b", bytes(35))
            yield topics.TERRAIN_CHANGE, change
        update = self._votes(self.stamp(), 1)
        yield topics.TERRAIN_UPDATE, update

    def votes_flood(self) -> Messages:
        """Empty votes, as fast as they go."""
        while True:
            yield topics.FUEL_VOTES, self._votes(self.stamp(), 0)

    def poses_flood(self) -> Messages:
        """Poses that belong to no image, as fast as they go."""
        while True:
            yield topics.POSE, self._pose(self.stamp())

    def questions_flood(self) -> Messages:
        """Questions to the map, as fast as they go."""
        message = topics.FUEL_MAP_QUERY.type()
        message.header.frame_id = "map"
        while True:
            message.point.x, message.point.y = self.rng.uniform(0, 1200), self.rng.uniform(0, 900)
            yield topics.FUEL_MAP_QUERY, message

    def _votes(self, stamp: int, cells: int, shift: float = 0.0) -> Any:
        """Of so many cells; the grid is none of the site's, so that none of them is counted where it is not refused
        for its stamp."""
        names = self._labels
        grid = GridGeometry(3.0 + shift, 900.0, 7.0, 30, 20)
        where = np.arange(cells, dtype=np.int32)
        counts = np.ones((cells, len(names)), np.uint32)
        return votes_to_msg(CellVotes(grid, where, where, counts, np.zeros(cells, np.float32), stamp, "", None), names)

    def _compressed(self, data: bytes, stamp: int, form: str = "jpeg") -> Any:
        message = topics.IMAGE_COMPRESSED.type(header=make_header(stamp, self._optical), format=form)
        message.data = array("B", data)
        return message

    def _any(self, topic: Topic) -> Any:
        stamp = self.stamp()
        if topic in POSES:
            return self._pose(stamp)
        if topic in CALIBRATIONS:
            return camera_to_msg(self._lens, stamp, self._optical)
        if topic is topics.FUEL_VOTES:
            return self._votes(stamp, 2)
        if topic is topics.IMAGE_COMPRESSED:
            return self._compressed(b"\xff\xd8\xff\xe0" + self.rng.randbytes(3000), stamp)
        return image_to_msg(self._numbers.integers(0, 255, (6, 9, 3), np.uint8), "rgb8", stamp, self._optical)


ATTACKS: dict[str, Callable[[Stranger], Messages]] = {
    "vast pictures": Stranger.vast_pictures,
    "large messages": Stranger.large_messages,
    "vast calibrations": Stranger.vast_calibrations,
    "impossible poses": Stranger.impossible_poses,
    "forged votes": Stranger.forged_votes,
    "hostile strings": Stranger.hostile_strings,
    "noise": Stranger.noise,
    "site topics": Stranger.site_topics,
}
FLOODS: dict[str, Callable[[Stranger], Messages]] = {
    "votes": Stranger.votes_flood,
    "poses": Stranger.poses_flood,
    "questions": Stranger.questions_flood,
}


def main(attack: str, camera: str, seconds: float, seed: int) -> None:
    rclpy.init()
    node = Node("stranger", enable_rosout=False)
    publishers: dict[Topic, Any] = {}

    def publisher(topic: Topic) -> Any:
        if topic not in publishers:
            of_site = topic in SITE_TOPICS
            name = f"/{NAME}/{topic.name}" if of_site else f"/{NAME}/{camera}/{topic.name}"
            publishers[topic] = node.create_publisher(topic.type, name, stream_qos(topic.latched))
            deadline = time.monotonic() + LISTENED_S
            while publishers[topic].get_subscription_count() < 1 and time.monotonic() < deadline:
                time.sleep(0.02)
        return publishers[topic]

    make = (ATTACKS | FLOODS)[attack]
    until = time.monotonic() + seconds
    sent = 0
    for topic, message in make(Stranger(camera, random.Random(seed))):
        if attack in FLOODS and time.monotonic() > until:
            break
        publisher(topic).publish(message)
        sent += 1
    for one in publishers.values():
        one.wait_for_all_acked(rclpy.duration.Duration(seconds=2))
    print(sent, flush=True)
    limit_shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], float(sys.argv[3]), int(sys.argv[4]))
