"""recorder: write the serialised messages of topics into MCAP bags, within limits of disk space."""

import re
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import Field
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_msgs_py.bag.cdr import TF_TYPE, CameraFrames
from ltm_msgs_py.bag.reader import decoded
from ltm_msgs_py.bag.schemas import message_class
from ltm_ros.recordings.bounded_recording import BoundedRecording, RecordingLimits, RecordingThread
from ltm_ros.runtime.delivery_checks import DiagnosticsPublisher, LossCounter, with_info
from ltm_ros.runtime.handler import NodeConfig
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.node_process import EX_IOERR, run_until_stopped
from ltm_ros.runtime.outlet_node import read_parameters
from ltm_ros.runtime.process_memory import map_large_blocks
from ltm_ros.runtime.topics import POSED_POSE, RECORDED, camera_topic, input_topic, site_topic

_FREQUENT = ("sensor_msgs/msg/Imu", TF_TYPE)
"""Types of small messages that come up to two hundred times a second."""


class RecorderConfig(NodeConfig):
    bag: str
    """Folder to write; if it exists, `<bag>_1` and so on is used."""
    topics: list[str] = Field(default_factory=list)
    """Absolute topic names or patterns (`/site/*/depth/*`); empty: the site's inputs, results, truth and
    diagnostics."""
    max_bytes: int = Field(-1, ge=-1)
    """Maximum bytes of all recordings named `bag`; the oldest files are deleted first. -1: 16 GB, or half of the disk
    if that is less; 0: unlimited."""
    min_free_bytes: int = Field(-1, ge=-1)
    """Free bytes of the disk below which recording stops. -1: 2 GB, or a tenth of the disk if that is less."""
    file_bytes: int = Field(256 << 20, ge=1)
    """Bytes after which the next file begins, at most a quarter of `max_bytes`."""
    file_seconds: float = Field(600.0, gt=0)
    """Seconds after which the next file begins."""


class Recorder(Node):  # type: ignore[misc]
    """Subscribes to serialised messages, so nothing is decoded; a separate thread writes to the disk."""

    def __init__(self) -> None:
        super().__init__("recorder", automatically_declare_parameters_from_overrides=True)
        map_large_blocks()  # a message stays queued until it is on the disk
        config = read_parameters(self, RecorderConfig)
        self.health = Health()
        self.health.gauge("discovered", 0)
        site = load_site(config.site)
        self._patterns = _patterns(config, site)
        self._taken: set[str] = set()
        poses = {} if config.topics else {camera_topic(site.name, name, POSED_POSE): name for name in site.cameras}
        self._poses, self._frames = frozenset(poses), CameraFrames(poses)
        path, tell = Path(config.bag), self.get_logger().warning
        given = config.max_bytes, config.min_free_bytes, config.file_bytes, config.file_seconds
        limits = RecordingLimits.of(path, *given)
        recording = BoundedRecording(path, self.get_fully_qualified_name(), limits, self.health, tell)
        self._disk = RecordingThread(recording, self.health, partial(tell, throttle_duration_sec=5.0))
        # Flushed to the operating system every second, to survive a kill.
        self.create_timer(1.0, self._disk.flush, clock=DiagnosticsPublisher.steady_clock())
        self.create_timer(0.2, self._discover, clock=DiagnosticsPublisher.steady_clock())
        self._diagnostics = DiagnosticsPublisher(self, {self.get_fully_qualified_name(): self.health})

    def close(self) -> int:
        """Write the queued messages within a time limit, finish the bag, and return the process's exit status."""
        whole = self._disk.close()
        self._diagnostics.publish()
        return 0 if whole else EX_IOERR

    def _discover(self) -> None:
        """Subscribe to topics as they appear, with the offered durability and reliability."""
        known = self.count_publishers("/diagnostics")
        for topic, types in self.get_topic_names_and_types():
            if topic in self._taken or not any(fnmatchcase(topic, pattern) for pattern in self._patterns):
                continue
            offers = self.get_publishers_info_by_topic(topic)
            if not offers:
                continue
            self._taken.add(topic)
            try:
                message_type = message_class(types[0])
            except LtmError as error:
                self.health.drop(cause_of(error), f"{topic}: {error}")
                continue
            latched = all(o.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for o in offers)
            reliable = all(o.qos_profile.reliability == ReliabilityPolicy.RELIABLE for o in offers)
            self._disk.add_topic(topic, types[0], latched)
            qos = QoSProfile(
                depth=100 if types[0] in _FREQUENT else 10,
                reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
                durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
            )
            losses = None if latched else LossCounter(self, topic, self.health)
            taker = with_info(partial(self._take, topic, types[0], losses))
            self.create_subscription(message_type, topic, taker, qos, raw=True)
        self.health.gauge("discovered", known)

    def _take(self, topic: str, type_name: str, losses: LossCounter | None, cdr: bytes, info: Any) -> None:
        if losses is not None:
            losses.take(info)
        self.health.received(topic)
        now = self.get_clock().now().nanoseconds
        self._disk.take(topic, type_name, cdr, now)
        if topic not in self._poses:
            return
        try:
            for name, raw, once in self._frames.beside(topic, decoded(cdr, type_name)):
                if name not in self._taken:
                    self._taken.add(name)
                    self._disk.add_topic(name, TF_TYPE, once)
                self._disk.take(name, TF_TYPE, raw, now)
        except LtmError as error:
            self.health.drop(cause_of(error), f"{topic}: {error}")


def _patterns(config: RecorderConfig, site: Site) -> list[str]:
    for pattern in config.topics:
        if not re.fullmatch(r"/[A-Za-z0-9_/*?\[\]-]+", pattern):
            raise ConfigError(
                f"topic {pattern!r} cannot be recorded: give absolute names or patterns such as /site/*/depth/*"
            )
    if config.topics:
        return list(config.topics)
    cameras, whole_site = RECORDED
    names = [camera_topic(site.name, name, input_topic(one, t)) for name, one in site.cameras.items() for t in cameras]
    return [*names, *(site_topic(site.name, topic) for topic in whole_site), "/diagnostics"]


CONFIG = RecorderConfig

if __name__ == "__main__":
    run_until_stopped("recorder", Recorder)
