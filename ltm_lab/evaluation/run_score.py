"""Scores a recorded run as a whole against truth: depth, labels, skyline, fuel cells, terrain, latency."""

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from ltm_core.base.errors import LtmError
from ltm_core.vision.labels import Label
from ltm_lab.evaluation.dated_run import DatedRun
from ltm_lab.evaluation.metrics.skyline import SkylineScore, SkylineTally, depth_skyline, skyline
from ltm_lab.evaluation.terrain_score import TerrainScore, score_terrain
from ltm_msgs_py.bag.cdr import header_of
from ltm_msgs_py.bag.reader import BagReader
from ltm_ros.demo.score import DEPTH_SOURCES, RunScore, RunTally
from ltm_ros.recordings.frame_stream import FrameStream, StreamedFrame
from ltm_ros.recordings.recorded_run import image_shape
from ltm_ros.runtime.topics import (
    DEPTH_IMAGE,
    FUEL_VOTES,
    FUSED_DEPTH,
    LABELS_IMAGE,
    NETWORK_DEPTH,
    POSED_POSE,
    camera_topic,
)

_RESULTS = (POSED_POSE, DEPTH_IMAGE, NETWORK_DEPTH, FUSED_DEPTH, LABELS_IMAGE, FUEL_VOTES)


@dataclass(frozen=True)
class LatencyRow:
    """How long after a frame's stamp its message was logged, milliseconds."""

    camera: str
    topic: str
    messages: int
    p50_ms: float
    p95_ms: float
    max_ms: float


@dataclass(eq=False)
class BagScore(RunScore):
    """All scores of a bag: those of a run, its skylines, terrain changes and latencies."""

    skylines: list[tuple[str, SkylineScore]] = field(default_factory=list)
    terrain: TerrainScore | None = None
    latency: list[LatencyRow] = field(default_factory=list)


def score_bag(recorded: DatedRun) -> BagScore:
    """Score all frames that carry truth. Raises LtmError if the bag cannot be read."""
    stream = FrameStream(recorded.bag, recorded.site)
    tally = RunTally(recorded, stream)
    lines = {name: SkylineTally() for name in ("traced", "labels")}
    for frame in stream.frames():
        tally.add(frame)
        if "truth_depth" in frame:
            _add_skylines(lines, frame, image_shape(frame, recorded.site))
    score = BagScore(**vars(tally.score()))
    wanted = {"truth": "truth_depth", "labels": "labels", **{f"depth, {name}": name for name in DEPTH_SOURCES}}
    score.lacking += [f"{name}: the bag has none" for name, part in wanted.items() if not stream.has(part)]
    score.skylines = [(name, line.score()) for name, line in lines.items() if line.score().columns]
    score.latency = _latencies(recorded)
    measured = {name for name, _ in score.skylines}
    score.lacking += [f"skyline, {name}: no frame shows one" for name in ("traced", "labels") if name not in measured]
    if not score.latency:
        score.lacking.append(
            "latency: every log time is its message's stamp, as an offline replay or a simulation writes it"
        )
    _score_terrain(score, recorded)
    return score


def _add_skylines(lines: dict[str, SkylineTally], frame: StreamedFrame, image: tuple[int, int]) -> None:
    """Traced sky against the skyline of bare ground, labelled sky against that of the visible surface."""
    ground, surface = frame.take("truth_ground"), frame.take("truth_depth")
    traced, labels = frame.take("traced"), frame.take("labels")
    if ground is not None and traced is not None and traced.shape == image:
        lines["traced"].add(depth_skyline(traced), depth_skyline(ground), round(image[1] / ground.shape[1]))
    if labels is not None and labels.shape == image:
        sky = labels == Label.SKY
        lines["labels"].add(skyline(sky), depth_skyline(surface), round(image[1] / surface.shape[1]))


def _latencies(recorded: DatedRun) -> list[LatencyRow]:
    site, rows, found = recorded.site, [], defaultdict[tuple[str, str], list[float]](list)
    names = {camera_topic(site.name, name, topic): (name, topic.name) for name in site.cameras for topic in _RESULTS}
    for message in BagReader(recorded.bag).messages(names):
        stamp, _ = header_of(message.raw)
        found[names[message.topic]].append((message.log_time_ns - stamp) / 1e6)
    for (camera, topic), values in sorted(found.items()):
        if np.any(values):
            p50, p95 = np.percentile(values, [50, 95])
            rows.append(LatencyRow(camera, topic, len(values), float(p50), float(p95), float(np.max(values))))
    return rows


def _score_terrain(score: BagScore, recorded: DatedRun) -> None:
    now, earlier = recorded.surfaces
    if now is None:
        score.lacking.append(f"terrain: no truth/DATE/surface.tif in {recorded.truth}; name it with --truth and --date")
        return
    try:
        score.terrain = score_terrain(recorded.bag, recorded.site, now, earlier)
    except LtmError as error:
        score.lacking.append(f"terrain: {error}")
        return
    if score.terrain.cells == 0:
        score.terrain = None
        score.lacking.append("terrain: independent views have looked at no cell together")
    elif score.terrain.change is None:
        score.lacking.append("change: no true surface of an earlier date, or no threshold in terrain/info")
