"""A running graph of the small site, and somebody who sends to it whatever a test makes."""

from array import array
from collections import Counter
from typing import Any

from bystander import Bystander
from scenes.small_site import BEGIN_NS, NAME, TOWER, SmallSite
from scenes.waiting import wait_for

from ltm_msgs_py.image import compressed_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.topics import (
    CAMERA_INFO,
    DEPTH_IMAGE,
    FUEL_MAP_UPDATE,
    FUEL_VOTES,
    IMAGE_COMPRESSED,
    IMAGE_RAW,
    POSE,
    camera_topic,
    site_topic,
)

NODES = (
    "fuel_map",
    "tower/capture",
    "tower/depth",
    "tower/segmentation",
    "tower/fuel_votes",
    "mast/capture",
    "mast/depth",
)
INPUTS = {
    **{topic: camera_topic(NAME, "tower", topic) for topic in (IMAGE_COMPRESSED, CAMERA_INFO, POSE, FUEL_VOTES)},
    IMAGE_RAW: camera_topic(NAME, "mast", IMAGE_RAW),
}
MAP_UPDATE = site_topic(NAME, FUEL_MAP_UPDATE)
MAST_DEPTH = camera_topic(NAME, "mast", DEPTH_IMAGE)


def counted(summary: dict[str, str]) -> dict[str, int]:
    return {k: int(v) for k, v in summary.items() if k.startswith(("dropped.", "noted."))}


class Living:
    """A running graph without recorder and viewer, and somebody who sends to it."""

    def __init__(self, small: SmallSite, runner: Runner, bystander: Bystander) -> None:
        self.small, self.runner, self.bystander = small, runner, bystander
        self._stamp = BEGIN_NS
        tower, mast = small.frames(1)
        self.tower, self.jpeg = tower, encode_rgb(small.photo(tower), quality=95)
        self.mast, self.photo = mast, small.photo(mast)
        self.counted: dict[str, Counter[str]] = {label: Counter() for label in NODES}
        """What every node has counted up to the end of the last test."""

    def stamp(self) -> int:
        """A new one, a second after the last."""
        self._stamp += 10**9
        return self._stamp

    def send(self, topic: Any, *messages: Any) -> None:
        for message in messages:
            self.bystander.send(INPUTS[topic], message)

    def image(self, stamp: int, data: bytes | None = None) -> Any:
        """The tower's photo, or any other bytes in its place."""
        message = compressed_to_msg(self.jpeg, "jpeg", stamp, "tower_optical")
        if data is not None:
            message.data = array("B", data)
        return message

    def info(self, stamp: int) -> Any:
        return camera_to_msg(TOWER, stamp, "tower_optical")

    def pose(self, stamp: int) -> Any:
        return pose_to_msg(self.tower.pose, stamp)

    def raw(self, stamp: int) -> Any:
        return image_to_msg(self.photo, "rgb8", stamp, "mast_optical")

    def posed(self, stamp: int, *images: Any) -> None:
        """Pose and calibration, and the images that go with them."""
        self.send(CAMERA_INFO, self.info(stamp))
        self.send(POSE, self.pose(stamp))
        self.send(IMAGE_COMPRESSED, *images)

    def good_frame(self) -> None:
        """One of each camera goes through the whole graph."""
        stamp = self.stamp()
        self.posed(stamp, self.image(stamp))
        self.send(IMAGE_RAW, self.raw(stamp))
        self.bystander.wait_for_stamp(MAP_UPDATE, stamp)
        self.bystander.wait_for_stamp(MAST_DEPTH, stamp)

    def counters(self) -> dict[str, Counter[str]]:
        """Drops and notes of every node, from diagnostics that came after this call."""
        self.bystander.forget()
        names = {label: f"/{NAME}/{label}" for label in NODES}
        wait_for(lambda: self.bystander.summaries.keys() >= {*names.values()}, "diagnostics of every node")
        latest = dict(self.bystander.summaries)
        return {label: Counter(counted(latest[name])) for label, name in names.items()}

    def pids(self) -> dict[str, int | None]:
        return {label: process.pid for label, process in self.runner.processes.items()}
