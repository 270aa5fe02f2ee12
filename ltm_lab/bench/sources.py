"""What it costs to ask many cameras for snapshots, and how true their stamps are: the process `sources` of a site on
HTTP cameras of this machine."""

from __future__ import annotations

import contextlib
import json
import subprocess  # nosec B404 # argument lists, no shell
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from ltm_core.base.errors import LtmError
from ltm_core.base.resources import project_path
from ltm_core.geometry.camera import Camera
from ltm_core.site.site_io import load_site
from ltm_core.site.source_config import RtspConfig
from ltm_lab.bench.process_usage import usage_of
from ltm_lab.bench.snapshot_cameras import time_in
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.image import compressed_to_rgb, encode_rgb
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.cameras.camera_source import CameraSource, Frame, Gaze
from ltm_ros.cameras.opening import open_reader
from ltm_ros.cameras.protocols.picture import CameraImage
from ltm_ros.launching.graph import SOURCES_PROCESS, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.nodes.source import JPEG_QUALITY
from ltm_ros.runtime.clocks import SystemClock
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.ros_environment import apply_to_process
from ltm_ros.runtime.spinning_node import SpinningNode
from ltm_ros.runtime.topics import IMAGE_COMPRESSED, SOURCE_INFO, camera_topic

NAME = "bench"
READY_S, SETTLE_S = 120.0, 5.0
_DEMO = "bags/demo"


@dataclass(frozen=True)
class SourcesResult:
    """`pictures`: that came of all cameras in `seconds`. `cores`: share of one core that the process took meanwhile.
    Errors in seconds, stamp less true time, of one camera; `held`: the share of them within what was told."""

    cameras: int
    every: float
    seconds: float
    pictures: int
    picture_kb: float
    cores: float
    pss_mb: float
    threads: int
    errors: list[float]
    held: float

    @property
    def cpu_ms_each(self) -> float:
        return 1000 * self.cores * self.seconds / self.pictures

    @property
    def median_s(self) -> float:
        return float(np.median(np.abs(self.errors)))

    @property
    def p95_s(self) -> float:
        return float(np.quantile(np.abs(self.errors), 0.95))


def run_sources(
    cameras: int, every: float, seconds: float, width: int = 1920, ahead: float = 37.0, domain_id: int | None = None
) -> SourcesResult:
    """`ahead`: seconds by which the cameras' clock is wrong. Raises LtmError where it does not run."""
    apply_to_process(domain_id)
    with tempfile.TemporaryDirectory(prefix="ltm-bench-") as place:
        folder = Path(place)
        size = _photo(folder / "photo.jpg", width)
        with _serving(folder / "photo.jpg", ahead) as port:
            path = _site(folder, cameras, every, size, port)
            graph = describe(load_site(path), path)
            asking = replace(graph, nodes=tuple(node for node in graph if node.name == "source"))
            runner = Runner(asking, domain_id=domain_id, log_folder=folder / "log", console=lambda line: None)
            with runner, _Listener([node.namespace.rpartition("/")[2] for node in asking.nodes]) as listener:
                runner.wait_until_ready(READY_S)
                time.sleep(SETTLE_S + every)
                process = runner.processes[SOURCES_PROCESS]
                before, began, seen = usage_of({"": process.pid or 0})[""], time.monotonic(), listener.count
                time.sleep(seconds)
                after, took = usage_of({"": process.pid or 0})[""], time.monotonic() - began
                pictures = listener.count - seen
                if process.starts > 1:
                    raise LtmError("the sources died and were started again")
                pairs = listener.pairs()
            if not pairs or not pictures:
                raise LtmError("no picture came through")
            errors = [stamp - true for stamp, true, _ in pairs]
            return SourcesResult(
                cameras,
                every,
                took,
                pictures,
                (folder / "photo.jpg").stat().st_size / 1000,
                (after.cpu_s - before.cpu_s) / took,
                after.pss / 1024,
                after.threads,
                errors,
                float(np.mean([abs(error) <= told for error, (_, _, told) in zip(errors, pairs, strict=True)])),
            )


@dataclass(frozen=True)
class StreamResult:
    """Of one RTSP stream. `cores`: share of one core for reading, decoding and, as the node does, writing JPEGs."""

    frames: str
    seconds: float
    pictures: int
    size: tuple[int, int]
    cores: float
    state: str


def run_stream(url: str, frames: str, seconds: float) -> StreamResult:
    """Read a stream in this process. Raises LtmError where none comes."""
    config = RtspConfig.model_validate({"kind": "rtsp", "url": url, "frames": frames})
    sizes: list[tuple[int, int]] = []
    clock = SystemClock()

    def deliver(frame: Frame) -> None:
        assert frame.rgb is not None  # nosec B101 # tells the type checker what holds
        encode_rgb(frame.rgb, "jpeg", JPEG_QUALITY)
        sizes.append((frame.rgb.shape[1], frame.rgb.shape[0]))

    first = open_reader(config, 0, clock)
    try:
        while not isinstance(picture := first.read(), CameraImage):
            pass
    finally:
        first.close()
    assert picture.rgb is not None  # nosec B101 # tells the type checker what holds
    calibration = Camera.from_fov(picture.rgb.shape[1], picture.rgb.shape[0], 60.0)
    source = CameraSource(config, calibration, Gaze(), lambda: open_reader(config, 0, clock), deliver, Health(), clock)
    while not sizes:
        time.sleep(source.step())
    sizes.clear()
    began, used = time.monotonic(), time.process_time()
    while time.monotonic() < began + seconds:
        time.sleep(source.step())
    took = time.monotonic() - began
    cores = (time.process_time() - used) / took
    source.close()
    return StreamResult(frames, took, len(sizes), (calibration.width, calibration.height), cores, source.state.value)


class _Listener(SpinningNode):
    """Counts the pictures of all `cameras`, and keeps of the first one's the stamp, the true time and the uncertainty
    that was told."""

    def __init__(self, cameras: Sequence[str]) -> None:
        super().__init__("bench_sources")
        self.count = 0
        self._true: dict[int, float] = {}
        self._told: dict[int, float] = {}
        # The other cameras' pictures are counted by what is told of each: to send them would cost more than to ask.
        topic = camera_topic(NAME, cameras[0], IMAGE_COMPRESSED)
        self.node.create_subscription(IMAGE_COMPRESSED.type, topic, self._on_image, stream_qos())
        for number, camera in enumerate(cameras):
            info = camera_topic(NAME, camera, SOURCE_INFO)
            told = partial(self._on_info, first=number == 0)
            self.node.create_subscription(SOURCE_INFO.type, info, told, stream_qos())

    def pairs(self) -> list[tuple[float, float, float]]:
        """Stamp, true time, uncertainty; seconds."""
        return [(s / 1e9, true, self._told[s]) for s, true in sorted(self._true.items()) if s in self._told]

    def _on_image(self, message: Any) -> None:
        self._true[stamp_of(message)] = time_in(bytes(memoryview(message.data)))

    def _on_info(self, message: Any, first: bool) -> None:
        self.count += 1
        if not first:
            return
        said = json.loads(message.data)
        self._told[said["stamp_ns"]] = said["uncertainty_s"]


def _photo(path: Path, width: int) -> tuple[int, int]:
    """One of the demo's, enlarged, with the grain of a sensor; its size."""
    site = load_site(project_path(_DEMO) / "site.yaml")
    topic = camera_topic(site.name, next(iter(site.cameras)), IMAGE_COMPRESSED)
    reader = BagReader(project_path(_DEMO) / "recording")
    photo = compressed_to_rgb(reader.decode(next(iter(reader.messages([topic])))))
    height = round(photo.shape[0] * width / photo.shape[1])
    larger = cv2.resize(photo, (width, height), interpolation=cv2.INTER_CUBIC).astype(np.int16)
    grain = np.random.default_rng(1).normal(0.0, 4.0, larger.shape)
    path.write_bytes(encode_rgb(np.clip(larger + grain, 0, 255).astype(np.uint8), quality=85))
    return width, height


def _site(folder: Path, cameras: int, every: float, size: tuple[int, int], port: int) -> Path:
    original = load_site(project_path(_DEMO) / "site.yaml")
    dem = project_path(_DEMO) / "dem.tif"
    x, y = (float(v) for v in original.origin)
    place = original.open_dem().geometry
    middle = (x + (place.bounds[0] + place.bounds[2]) / 2, y + (place.bounds[1] + place.bounds[3]) / 2)
    camera = {
        "calibration": {"width": size[0], "height": size[1], "hfov_deg": 62.0},
        "pose": {"x": middle[0], "y": middle[1], "height_above_ground": 30.0, "azimuth_deg": 40.0},
    }
    names = [f"c{number:02d}" for number in range(cameras)]
    content = {
        "name": NAME,
        "crs": original.crs,
        "origin": [x, y],
        "dem": {"path": str(dem.resolve())},
        "cameras": {
            name: camera
            | {"source": {"kind": "snapshot", "url": f"http://127.0.0.1:{port}/{name}.jpg", "every": every}}
            for name in names
        },
    }
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


@contextlib.contextmanager
def _serving(photo: Path, ahead: float) -> Iterator[int]:
    """The port of cameras in a process of their own."""
    command = [sys.executable, "-m", "ltm_lab.bench.snapshot_cameras", str(photo), str(ahead)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:  # nosec B603
        try:
            assert server.stdout is not None  # nosec B101 # tells the type checker what holds
            yield int(server.stdout.readline())
        finally:
            server.kill()
