"""Simulated cameras of the graph benchmark, all in one process of their own, and a listener to the fuel map."""

import struct
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node

from ltm_core.base.errors import LtmError
from ltm_lab.bench.graph_site import NAME, SENT, stamped
from ltm_lab.bench.measure import own_process
from ltm_lab.spinning_node import SpinningNode
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.ros_environment import limit_shutdown
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE, camera_topic, site_topic

PATIENCE_S = 120.0
QUIET_S = 6.0
"""Seconds without any update of the map after which no more are expected."""
LONGEST_SETTLE_S = 60.0
_MOST_CAMERAS = 1000


@dataclass(frozen=True)
class Sent:
    """Stamps of the frames by camera, ns, and the largest delay of the sending process, s."""

    stamps: dict[str, list[int]]
    late_s: float

    @property
    def all_stamps(self) -> set[int]:
        """The stamps of all cameras."""
        return {stamp for stamps in self.stamps.values() for stamp in stamps}


class CameraSender:
    """A process that sends the frames of all cameras in `folder` (`write_site`); a context manager.

    Raises LtmError if no graph listens to the cameras.
    """

    def __init__(self, folder: Path, cameras: Sequence[str]) -> None:
        self._process = own_process()
        self._folder, self._cameras = folder, tuple(cameras)

    def __enter__(self) -> Self:
        if not self._process.submit(_Cameras.open, self._folder, self._cameras).result():
            self.__exit__()
            raise LtmError("no graph listens to the cameras of the benchmark; see the log of the graph")
        return self

    def __exit__(self, *_: object) -> None:
        self._process.submit(_Cameras.close).result()
        self._process.shutdown()

    def stream(self, frames: int, period_s: float) -> Sent:
        """Send `frames` frames of every camera, `period_s` apart, and return when all are sent."""
        return self._process.submit(_Cameras.stream, frames, period_s).result()


class _Cameras:
    """The cameras in the sending process."""

    _running: "_Cameras"

    def __init__(self, folder: Path, cameras: Sequence[str]) -> None:
        self._frames = {
            camera: [
                {part: (folder / camera / f"{number:03d}.{part}.cdr").read_bytes() for part in SENT}
                for number in range(len([*(folder / camera).glob("*.image.cdr")]))
            ]
            for camera in cameras
        }
        rclpy.init()
        self._node = Node("cameras", enable_rosout=False)
        self._publishers = {
            (camera, part): self._node.create_publisher(topic.type, camera_topic(NAME, camera, topic), stream_qos())
            for camera in cameras
            for part, topic in SENT.items()
        }

    @staticmethod
    def open(folder: Path, cameras: Sequence[str]) -> bool:
        """Start the cameras and return whether the graph listens to all of them."""
        opened = _Cameras._running = _Cameras(folder, cameras)
        deadline = time.monotonic() + PATIENCE_S
        while any(publisher.get_subscription_count() < 1 for publisher in opened._publishers.values()):
            if time.monotonic() > deadline:
                return False
            time.sleep(0.05)
        return True

    @staticmethod
    def stream(frames: int, period_s: float) -> Sent:
        """Send the frames, the cameras evenly apart."""
        cameras = _Cameras._running
        sent: dict[str, list[int]] = {camera: [] for camera in cameras._frames}
        begin, late = time.time() + 0.5, 0.0
        for number in range(frames):
            for index, (camera, pool) in enumerate(cameras._frames.items()):
                due = begin + (number + index / len(cameras._frames)) * period_s
                while (wait := due - time.time()) > 0:
                    time.sleep(wait)
                late = max(late, -wait)
                # Unique over all cameras, so that an update of the map names its frame.
                stamp = time.time_ns() // _MOST_CAMERAS * _MOST_CAMERAS + index
                for part, cdr in pool[number % len(pool)].items():
                    cameras._publishers[camera, part].publish(stamped(cdr, stamp))
                sent[camera].append(stamp)
        return Sent(sent, late)

    @staticmethod
    def close() -> None:
        """End the cameras."""
        limit_shutdown()
        _Cameras._running._node.destroy_node()
        rclpy.try_shutdown()


class Listener(SpinningNode):
    """Records the updates of the fuel map and the diagnostics of a site; a context manager.

    `arrived` is the time of the first update with a stamp, epoch seconds by the clock of this machine. `summaries` are
    the last diagnostics of every node by its full name.
    """

    def __init__(self) -> None:
        super().__init__("bench")
        self.arrived: dict[int, float] = {}
        self.summaries: dict[str, dict[str, str]] = {}
        qos = stream_qos(depth=FUEL_MAP_UPDATE.depth)
        self.node.create_subscription(OccupancyGrid, site_topic(NAME, FUEL_MAP_UPDATE), self._updated, qos, raw=True)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._diagnosed, 200)

    def settle(self, stamps: set[int]) -> None:
        """Wait for the updates with these stamps, or until none comes for a while; then for the diagnostics."""
        deadline, last, since = time.monotonic() + LONGEST_SETTLE_S, -1, time.monotonic()
        while (found := len(stamps & self.arrived.keys())) < len(stamps) and time.monotonic() < deadline:
            if found != last:
                last, since = found, time.monotonic()
            if time.monotonic() - since > QUIET_S:
                break
            time.sleep(0.1)
        time.sleep(2.2)  # diagnostics come once a second

    def _updated(self, cdr: bytes) -> None:
        sec, nanosec = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, 4)
        self.arrived.setdefault(sec * 10**9 + nanosec, time.time())

    def _diagnosed(self, message: Any) -> None:
        for status in message.status:
            self.summaries[status.name] = {item.key: item.value for item in status.values}
