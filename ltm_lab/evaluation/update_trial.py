"""Whether depth follows what the terrain confirms: a felled or burnt stand through the graph's own nodes.

Offline the handlers are fed one message at a time; live they are processes on DDS, which may be killed meanwhile.
"""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import LtmError
from ltm_core.base.types import Float32Array
from ltm_core.surface.observation import DepthFrame
from ltm_lab.evaluation.update_site import NAME, PARTS, UpdateSite, messages_of
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.confirmed_surface import msg_to_traced, msg_to_version
from ltm_msgs_py.image import msg_to_depth
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.supervisor import RestartPolicy
from ltm_ros.recordings.replay.offline import OfflineGraph
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.ros_environment import apply_to_process
from ltm_ros.runtime.spinning_node import SpinningNode
from ltm_ros.runtime.topics import DEPTH_IMAGE, DEPTH_INFO, TERRAIN_SURFACE, camera_topic, site_topic

READY_S = 300.0
LONGEST_S = 120.0
"""For which anything is waited for, on a busy machine."""
AGAIN_S = 5.0
"""After which what has come to nothing is sent again."""
SURFACE = site_topic(NAME, TERRAIN_SURFACE)

Depths = dict[tuple[str, int], tuple[str, Float32Array]]
"""By camera and stamp: the version of the surface that was traced to, and the depth (H, W)."""


def offline_depths(site: UpdateSite) -> tuple[Depths, str]:
    """Traced depth of the site's frames, and a digest of it and of the versions: the same in each run."""
    with tempfile.TemporaryDirectory(prefix="ltm-update-") as name:
        bag = Path(name) / "bag"
        writer = BagWriter(bag)
        graph = OfflineGraph(site.graph, writer)
        for frame in site.frames:
            for topic, message in messages_of(frame):
                graph.feed(camera_topic(NAME, frame.source, topic), message, frame.stamp_ns)
        graph.finish()
        writer.close()
        found = _Heard({frame.source for frame in site.frames})
        reader = BagReader(bag)
        for recorded in reader.messages(list(found.takes)):
            found.takes[recorded.topic](reader.decode(recorded))
    digest = hashlib.sha256("".join(found.versions).encode())
    for (camera, stamp), (version, depth) in sorted(found.depths().items()):
        digest.update(f"{camera} {stamp} {version}".encode() + np.ascontiguousarray(depth).tobytes())
    return found.depths(), digest.hexdigest()


def live_depths(site: UpdateSite, logs: Path, kills: bool, domain_id: int | None) -> Depths:
    """Traced depth of the site's frames through living processes; the last half is sent once a surface is confirmed.

    `kills`: kill -9 the terrain as it confirms, and each process that traces as it hears of that. What comes to nothing
    is sent again. Raises LtmError where nothing comes of it.
    """
    apply_to_process(domain_id)
    runner = Runner(
        site.graph,
        domain_id=domain_id,
        log_folder=logs,
        console=lambda line: None,
        policy=RestartPolicy(initial_s=0.1, maximum_s=1.0),
    )
    half = len(site.frames) // 2
    with runner, _Beside({frame.source for frame in site.frames}) as beside:
        runner.wait_until_ready(READY_S)
        beside.wait_for_listeners()
        for frame in site.frames[: half - 1]:
            beside.send_until_traced(frame)
        before = beside.heard.depths()
        beside.send(site.frames[half - 1])
        if kills:
            _kill(runner, ["terrain"])
        beside.send_until(lambda: bool(beside.version), site.frames[:half], "a confirmed surface")
        if kills:
            _kill(runner, [label for label in runner.processes if label != "terrain"])
        for frame in site.frames[half:]:
            beside.send_until_traced(frame)
        after = {key: traced for key, traced in beside.heard.depths().items() if key not in before}
        wanted = {(frame.source, frame.stamp_ns) for frame in site.frames}
        return {key: traced for key, traced in (before | after).items() if key in wanted}


class _Heard:
    """What came of the cameras' depth, and the versions in the order in which they were told of."""

    def __init__(self, cameras: set[str]) -> None:
        self.versions: list[str] = []
        self._depth: dict[tuple[str, int], Float32Array] = {}
        self._traced: dict[tuple[str, int], str] = {}
        self.takes: dict[str, Callable[[Any], None]] = {SURFACE: lambda m: self.versions.append(msg_to_version(m))}
        for camera in cameras:
            self.takes[camera_topic(NAME, camera, DEPTH_IMAGE)] = partial(self._on_depth, camera)
            self.takes[camera_topic(NAME, camera, DEPTH_INFO)] = partial(self._on_info, camera)

    def depths(self) -> Depths:
        """Of the frames of which all has come."""
        return {key: (self._traced[key], depth) for key, depth in self._depth.items() if key in self._traced}

    def _on_depth(self, camera: str, message: Any) -> None:
        self._depth[camera, stamp_of(message)] = msg_to_depth(message)

    def _on_info(self, camera: str, message: Any) -> None:
        stamp, version = msg_to_traced(message)
        self._traced[camera, stamp] = version


class _Beside(SpinningNode):
    """Sends the towers' frames and hears what comes of them."""

    def __init__(self, cameras: set[str]) -> None:
        super().__init__("update_trial")
        self.heard = _Heard(cameras)
        for topic, take in self.heard.takes.items():
            kind = TERRAIN_SURFACE if topic == SURFACE else DEPTH_IMAGE if topic.endswith("image") else DEPTH_INFO
            self.node.create_subscription(kind.type, topic, take, stream_qos(kind.latched, kind.depth))
        self._senders = {
            (camera, topic): self.node.create_publisher(topic.type, camera_topic(NAME, camera, topic), stream_qos())
            for camera in cameras
            for topic in PARTS
        }

    def wait_for_listeners(self) -> None:
        """Each part goes to the terrain, and pose and calibration to the tracing node too."""

        def wanted(topic: Any) -> int:
            return 1 if topic.name.startswith("measured") else 2

        _until(
            lambda: all(s.get_subscription_count() == wanted(topic) for (_, topic), s in self._senders.items()),
            "listeners",
        )

    def send(self, frame: DepthFrame) -> None:
        for topic, message in messages_of(frame):
            self._senders[frame.source, topic].publish(message)

    def send_until_traced(self, frame: DepthFrame) -> None:
        key = (frame.source, frame.stamp_ns)
        self.send_until(lambda: key in self.heard.depths(), [frame], f"depth of {key}")

    def send_until(self, condition: Callable[[], bool], frames: Sequence[DepthFrame], what: str) -> None:
        """Send frames, and again every few seconds, as to a process that is away. Raises LtmError."""
        end = time.monotonic() + LONGEST_S
        while not condition():
            if time.monotonic() > end:
                raise LtmError(f"no {what} within {LONGEST_S:.0f} s; see the nodes' logs")
            for frame in frames:
                self.send(frame)
            again = time.monotonic() + AGAIN_S
            while not condition() and time.monotonic() < again:
                time.sleep(0.05)

    @property
    def version(self) -> str:
        """That counts, as told last."""
        return self.heard.versions[-1] if self.heard.versions else ""


def _kill(runner: Runner, labels: list[str]) -> None:
    starts = {label: runner.processes[label].starts for label in labels}
    for label in labels:
        runner.kill(label)
    _until(
        lambda: all(runner.processes[one].starts > starts[one] and runner.processes[one].running for one in labels),
        "processes that are started again",
    )


def _until(condition: Callable[[], bool], what: str) -> None:
    """Raises LtmError where it does not come true."""
    end = time.monotonic() + LONGEST_S
    while not condition():
        if time.monotonic() > end:
            raise LtmError(f"no {what} within {LONGEST_S:.0f} s; see the nodes' logs")
        time.sleep(0.05)
