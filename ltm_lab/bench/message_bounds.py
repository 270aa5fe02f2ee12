"""Measures each node at the bounds of the site's `limits`: the memory that the largest frame which is taken costs it,
and what it costs to drop a larger one. Without DDS, each node in a process of its own.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.site.sections import MessageLimits
from ltm_core.site.site_io import load_site
from ltm_lab.bench import memory
from ltm_lab.bench.measure import peak_mb
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.camera_info import camera_to_msg
from ltm_msgs_py.image import compressed_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_ros.launching.graph import Graph, NodeSpec, describe
from ltm_ros.recordings.replay.offline import OfflineGraph
from ltm_ros.recordings.replay.run import ReplayOptions, run_offline
from ltm_ros.runtime.topics import CAMERA_INFO, IMAGE_COMPRESSED, IMAGE_RAW, POSE, POSED_CAMERA_INFO, POSED_POSE

CAMERA = "east"
DEM_CELLS = 2000
STAMP_NS = 1_800_000_000_000_000_000


@dataclass(frozen=True)
class NodeAtBound:
    """MB that a node's process held at most: before its first frame, and with frames of the most pixels taken."""

    node: str
    ready_mb: float
    most_mb: float


@dataclass(frozen=True)
class Dropped:
    """A message beyond a bound. `cpu_ms`: from its handing over until it is dropped; `grown_mb`: by which the most that
    the process ever held has grown meanwhile."""

    node: str
    message: str
    cause: str
    cpu_ms: float
    grown_mb: float


def largest_camera(limits: MessageLimits) -> Camera:
    """4:3, of as many pixels as are taken."""
    quarter = int((limits.pixels / 12) ** 0.5)
    return Camera.from_fov(4 * quarter, 3 * quarter, 60.0)


def nodes_at_bound(folder: Path, begin: Callable[[str], None] = lambda name: None) -> Iterator[NodeAtBound]:
    """Each node of a site of two cameras with fusion and terrain, written into `folder`, whose frames are as large as
    is taken. Raises BenchError.
    """
    begin("making frames")
    memory.make_site(folder, DEM_CELLS, largest_camera(MessageLimits()))
    site_path, bag, results = folder / "site.yaml", folder / "bag", folder / "results"
    content = yaml.safe_load(site_path.read_text())
    site_path.write_text(yaml.safe_dump(content | {"terrain": {}}, sort_keys=False))
    memory.run_command(memory.commands(folder)["import"])
    _apart(_record, bag, site_path, results)
    for spec in describe(load_site(site_path), site_path):
        if spec.label.startswith(f"{CAMERA}/") or "/" not in spec.label:
            begin(spec.label)
            ready, most = _apart(_memory_of, spec, results)
            yield NodeAtBound(spec.label, ready, most)


def dropped(folder: Path) -> Iterator[Dropped]:
    """Messages beyond the bounds, to the nodes that cameras talk to; `folder`: as `nodes_at_bound` left it."""
    content = yaml.safe_load((folder / "site.yaml").read_text())
    for node, kind, name, messages in _beyond():
        path = folder / f"site_{kind}.yaml"  # whose cameras send their poses and calibrations
        path.write_text(yaml.safe_dump(content | {"cameras": {CAMERA: {"image": kind}}}, sort_keys=False))
        spec = describe(load_site(path), path).node(f"{CAMERA}/{node}")
        cause, cpu_ms, grown = _apart(_drop, spec, messages)
        yield Dropped(spec.label, name, cause, cpu_ms, grown)


def _beyond() -> Iterator[tuple[str, str, str, list[tuple[str, Any]]]]:
    """Node, kind of its camera's images, what is too large, and messages by topic, of which the last is dropped."""
    limits, optical = MessageLimits(), f"{CAMERA}_optical"
    most = largest_camera(limits)
    larger = Camera.from_fov(most.width + 16, most.height + 12, 60.0)
    image = np.zeros((larger.height, larger.width, 3), np.uint8)
    jpeg, calibration = encode_rgb(image), camera_to_msg(larger, STAMP_NS, optical)
    pose = pose_to_msg(Pose.from_angles((0.0, 0.0, 1000.0), 0.0), STAMP_NS, "map")
    yield "capture", "compressed", "JPEG of more bytes", [_compressed(jpeg + bytes(limits.image_bytes), optical)]
    # It has no calibration, for one as large is not taken either.
    fitting = camera_to_msg(most, STAMP_NS, optical)
    ready = [(POSE.name, pose), (CAMERA_INFO.name, fitting)]
    yield "capture", "compressed", "JPEG of more pixels", [*ready, _compressed(jpeg, optical)]
    yield (
        "capture",
        "raw",
        "raw image of more pixels",
        [(IMAGE_RAW.name, image_to_msg(image, "rgb8", STAMP_NS, optical))],
    )
    yield "capture", "raw", "calibration of more pixels", [(CAMERA_INFO.name, calibration)]
    posed = [(POSED_POSE.name, pose), (POSED_CAMERA_INFO.name, calibration)]
    yield "depth", "raw", "calibration of more pixels", posed


def _compressed(jpeg: bytes, frame_id: str) -> tuple[str, Any]:
    return IMAGE_COMPRESSED.name, compressed_to_msg(jpeg, "jpeg", STAMP_NS, frame_id)


def _record(bag: Path, site: Path, results: Path) -> None:
    run_offline(bag, site, ReplayOptions(record=results), lambda done, total: None)


def _memory_of(spec: NodeSpec, results: Path) -> tuple[float, float]:
    """MB at most before and after all that a node listens to of a recording with results."""
    offline = OfflineGraph(Graph("bound", (spec,)))
    reader, ready = BagReader(results), peak_mb()
    for message in reader.messages([topic for topic in reader.topics() if offline.listened(topic)]):
        offline.feed(message.topic, reader.decode(message), message.log_time_ns)
    offline.finish()
    return ready, peak_mb()


def _drop(spec: NodeSpec, messages: Sequence[tuple[str, Any]]) -> tuple[str, float, float]:
    """Why the last of some messages, by topic, was dropped, with the processor time in ms and the growth in MB of that.
    Raises BenchError where it was not."""
    offline = OfflineGraph(Graph("bound", (spec,)))
    *before, (topic, last) = messages
    for name, message in before:
        offline.feed(f"{spec.namespace}/{name}", message, STAMP_NS)
    held, begun = peak_mb(), time.process_time()
    offline.feed(f"{spec.namespace}/{topic}", last, STAMP_NS)
    spent, grown = time.process_time() - begun, peak_mb() - held
    causes = [key for key in offline.healths[spec.full_name].summary() if key.startswith("dropped.")]
    if not causes:
        raise memory.BenchError(f"{spec.label} took a message on {topic} that is beyond its bounds")
    return ", ".join(causes), spent * 1e3, grown


def _apart(work: Callable[..., Any], *arguments: Any) -> Any:
    """In a process of its own, whose memory is that of the work alone."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(work, *arguments).result()
