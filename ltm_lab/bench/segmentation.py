"""`ltm-lab bench segmentation`: photos a second that a segmentation node labels in its own process, through real DDS."""

from __future__ import annotations

import os
import struct
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Image

from ltm_core.base.errors import LtmError
from ltm_core.base.types import UInt8Array
from ltm_core.site.site_io import load_site
from ltm_core.vision.usable import judge
from ltm_msgs_py.image import image_to_msg
from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.dds_shutdown import wait_for_quiet
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.ros_environment import apply_to_process
from ltm_ros.runtime.topics import LABELS_IMAGE, POSED_IMAGE, camera_topic

IN_FLIGHT = 2  # photos sent and not yet answered: the next one waits at the node, as on a busy tower
PATIENCE_S = 30.0
WARM_UP = 3  # photos that are not counted


def drawn_landscape(height: int, width: int) -> UInt8Array:
    """(height, width, 3) a sky over ground of several scales: of noise alone a node would not run its network, since
    it is no picture that can be used (`vision.usable`)."""
    rng = np.random.default_rng(0)
    photo = np.empty((height, width, 3), np.float32)
    photo[: height // 3] = (120, 160, 220)
    ground = np.zeros((height - height // 3, width), np.float32)
    for cells in (8, 40, 200):
        part = rng.normal(0.0, 22.0, (max(2, cells // 3), cells)).astype(np.float32)
        ground += cv2.resize(part, (width, len(ground)), interpolation=cv2.INTER_CUBIC)
    photo[height // 3 :] = np.array((125, 110, 80), np.float32) + ground[..., None]
    return np.clip(photo + rng.normal(0.0, 3.0, photo.shape), 0, 255).astype(np.uint8)


@dataclass(frozen=True)
class NodeRate:
    """`hz`: photos a second, by the clock. `cpu_ms`: of the node's process a photo, all its threads. `latency_ms`:
    median from sending to labels, with one photo ahead in the queue."""

    frames: int
    hz: float
    cpu_ms: float
    latency_ms: float


def run_segmentation(
    model: str, threads: int, photo: UInt8Array, frames: int, domain_id: int | None = None
) -> NodeRate:
    """One node that labels `photo` (H, W, 3) so many times. Raises LtmError where it does not start or answer, and for
    a photo that it would not label."""
    if (reason := judge(photo).reason) is not None:
        raise LtmError(f"the photo cannot be used ({reason}), so a node would not label it; give one of a landscape")
    apply_to_process(domain_id)
    with tempfile.TemporaryDirectory(prefix="ltm-bench-") as name:
        folder = Path(name)
        site = folder / "site.yaml"
        site.write_text("{name: bench, crs: 'EPSG:32611', origin: [0, 0], dem: {path: dem.tif}, cameras: {one: {}}}\n")
        own: dict[str, Any] = {"model": model, "threads": threads}
        node = describe(load_site(site), site, parameters={"segmentation": own}).node("one/segmentation")
        node = replace(node, process="")
        graph = Graph("bench", (node,))
        with Runner(graph, domain_id=domain_id, log_folder=folder / "log", console=lambda line: None) as runner:
            runner.wait_until_ready(60.0)
            process = runner.processes[node.label]
            with _Exchange(photo) as exchange:
                exchange.run(WARM_UP)
                before, begun = _cpu_s(process.pid), time.perf_counter()
                latency = exchange.run(frames)
                seconds, cpu = time.perf_counter() - begun, _cpu_s(process.pid) - before
    return NodeRate(frames, frames / seconds, 1e3 * cpu / frames, 1e3 * float(np.median(latency)))


class _Exchange:
    """Sends photos and waits for their labels; no more than IN_FLIGHT are on their way."""

    def __init__(self, photo: UInt8Array) -> None:
        self._photo = photo
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = Node("bench", context=self._context, enable_rosout=False)
        qos = stream_qos(depth=POSED_IMAGE.depth)
        self._publisher = self._node.create_publisher(Image, camera_topic("bench", "one", POSED_IMAGE), qos)
        labels = camera_topic("bench", "one", LABELS_IMAGE)
        self._node.create_subscription(Image, labels, self._labelled, qos, raw=True)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._sent: dict[int, float] = {}
        self._latency: list[float] = []
        self._stamp = 0

    def __enter__(self) -> _Exchange:
        self._wait(lambda: self._publisher.get_subscription_count() > 0, "listens to photos")
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        wait_for_quiet(self._node)
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def run(self, frames: int) -> list[float]:
        """Seconds from sending to labels, of each photo."""
        self._latency = []
        for _ in range(frames):
            self._wait(lambda: len(self._sent) < IN_FLIGHT, "answers")
            self._stamp += 1_000_000_000
            self._sent[self._stamp] = time.perf_counter()
            self._publisher.publish(image_to_msg(self._photo, "rgb8", self._stamp, "one_optical"))
        self._wait(lambda: not self._sent, "answers")
        return self._latency

    def _labelled(self, cdr: bytes) -> None:
        sec, nanosec = struct.unpack_from("<iI" if cdr[1] & 1 else ">iI", cdr, 4)
        begun = self._sent.pop(sec * 10**9 + nanosec, None)
        if begun is not None:
            self._latency.append(time.perf_counter() - begun)

    def _wait(self, done: Any, what: str) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not done():
            if time.monotonic() > deadline:
                raise LtmError(f"no segmentation node {what} after {PATIENCE_S:g} s; try `ltm models check`")
            self._executor.spin_once(timeout_sec=0.1)


def _cpu_s(pid: int | None) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
