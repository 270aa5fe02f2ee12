"""Scores a recorded run as a whole against truth: depth, labels, skyline, fuel cells, terrain, latency."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ltm_core.base.errors import LtmError
from ltm_core.base.resources import config_path
from ltm_core.base.types import Float32Array
from ltm_core.geometry.camera import Camera
from ltm_core.site.site import Site
from ltm_core.vision.labels import Label, LabelSet
from ltm_lab.evaluation.depth.depth_maps_io import DepthMapFolder
from ltm_lab.evaluation.fuel.map_score import MapScore
from ltm_lab.evaluation.metrics.depth import DepthScore
from ltm_lab.evaluation.metrics.depth_fit import DepthKind, at_pixels_of, fit_to_truth
from ltm_lab.evaluation.metrics.depth_tally import DepthTally
from ltm_lab.evaluation.metrics.fuel import FuelScore
from ltm_lab.evaluation.metrics.segmentation import SegmentationScore
from ltm_lab.evaluation.metrics.skyline import SkylineScore, SkylineTally, depth_skyline, skyline
from ltm_lab.evaluation.run_fuel_score import FuelTally
from ltm_lab.evaluation.terrain_score import TerrainScore, score_terrain
from ltm_ros.recordings.frame_stream import FrameStream, StreamedFrame
from ltm_ros.recordings.recorded_run import Recorded, image_shape
from ltm_ros.runtime.topics import (
    DEPTH_IMAGE,
    FUEL_VOTES,
    FUSED_DEPTH,
    LABELS_IMAGE,
    NETWORK_DEPTH,
    POSED_POSE,
    TRUTH_LABELS,
)

DEPTH_SOURCES = {"traced": DEPTH_IMAGE, "network": NETWORK_DEPTH, "fused": FUSED_DEPTH}
TRUTHS = {"visible surface": "truth_depth", "bare ground": "truth_ground"}
SHARED = "visible surface, shared pixels"
"""The pixels of frames that every source has a depth for: on them sources compare with each other."""
_RESULTS = (POSED_POSE, DEPTH_IMAGE, NETWORK_DEPTH, FUSED_DEPTH, LABELS_IMAGE, FUEL_VOTES)


@dataclass(frozen=True)
class DepthRow:
    """One source of depth against one truth; `scores`: by range, then over all. `coverage`: see DepthTally."""

    source: str
    against: str
    frames: int
    coverage: float
    scores: Sequence[DepthScore]


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
class BagScore:
    """Everything that a bag could be scored on; `lacking` says what it could not, and why."""

    bag: Path
    site: Site
    class_names: tuple[str, ...]
    frames: int = 0
    depth: list[DepthRow] = field(default_factory=list)
    skylines: list[tuple[str, SkylineScore]] = field(default_factory=list)
    labels: SegmentationScore | None = None
    fuel: FuelScore | None = None
    fuel_vote: FuelScore | None = None
    """The paper's majority vote of the same frames' votes, on the same cells."""
    fuel_prior: FuelScore | None = None
    """The map that the system started from, on the same cells."""
    fuel_changes: MapScore | None = None
    """What of that map has changed, on the same cells."""
    terrain: TerrainScore | None = None
    latency: list[LatencyRow] = field(default_factory=list)
    lacking: list[str] = field(default_factory=list)


def score_bag(recorded: Recorded, folders: Sequence[DepthMapFolder] = ()) -> BagScore:
    """Scores over all frames that carry truth, streamed. Raises LtmError on a bag that cannot be read."""
    site = recorded.site
    label_set = LabelSet.load(config_path(site.labels))
    stream = recorded.stream()
    score = BagScore(recorded.bag, site, label_set.names)
    names = [*DEPTH_SOURCES, *(folder.name for folder in folders)]
    expected = [name for name in names if name not in DEPTH_SOURCES or stream.has(name)]
    tallies = {(name, against): DepthTally() for name in names for against in (*TRUTHS, SHARED)}
    lines = {name: SkylineTally() for name in ("traced", "labels")}
    maps: Counter[str] = Counter()
    example = ""
    labels = SegmentationScore.empty(len(label_set))
    fuel = FuelTally(recorded)
    for frame in stream.frames():
        fuel.add(frame)
        if "truth_depth" not in frame:
            continue
        score.frames += 1
        example = example or f"{frame.camera_name}/{frame.stamp_ns}.npy"
        image = image_shape(frame, site)
        found = estimates(frame, folders, image)
        maps.update(name for name, _ in found)
        for against, part in TRUTHS.items():
            truth = frame.take(part)
            if truth is not None:
                depths = {name: in_metres(depth, kind_of(name, folders), truth, image) for name, depth in found}
                for name, metres in depths.items():
                    tallies[name, against].add(metres, truth)
                if part == "truth_depth" and len(depths) == len(expected) > 1:
                    _add_shared(tallies, depths, truth)
        _add_skylines(lines, frame, image)
        truth_labels, given = frame.take("truth_labels"), frame.take("labels")
        if truth_labels is not None and given is not None:
            labels = labels.plus(truth_labels, at_pixels_of(given, image, truth_labels.shape))
    for (name, against), tally in tallies.items():
        if tally.coverage > 0:
            score.depth.append(DepthRow(name, against, tally.frames, tally.coverage, tally.scores()))
    score.skylines = [(name, line.score()) for name, line in lines.items() if line.score().columns]
    score.labels = labels if labels.pixels else None
    score.latency = _latencies(stream)
    fuels = fuel.scores()
    score.fuel, score.fuel_vote, score.fuel_prior = fuels.fuel, fuels.vote, fuels.prior
    score.fuel_changes = fuels.changes
    if fuel.lacking is not None:
        score.lacking.append(fuel.lacking)
    _score_terrain(score, recorded)
    if score.frames:
        score.lacking[:0] = [f"depth, {f.name}: {why}" for f in folders if (why := _missed(score, f, maps, example))]
    score.lacking[:0] = _lacking(score, stream)
    return score


def _add_shared(
    tallies: dict[tuple[str, str], DepthTally], found: dict[str, Float32Array], truth: Float32Array
) -> None:
    everywhere = np.all([np.isfinite(metres) for metres in found.values()], axis=0)
    for name, metres in found.items():
        tallies[name, SHARED].add(np.where(everywhere, metres, np.float32(np.nan)), truth)


def kind_of(source: str, folders: Sequence[DepthMapFolder]) -> DepthKind:
    for folder in folders:
        if folder.name == source:
            return folder.config.kind
    return "metric"


def in_metres(depth: Float32Array, kind: DepthKind, truth: Float32Array, image: tuple[int, int]) -> Float32Array:
    """A depth image at the truth's pixels, in metres; one without a scale is fitted to the truth."""
    return fit_to_truth(at_pixels_of(depth, image, truth.shape), truth, kind)


def estimates(
    frame: StreamedFrame, folders: Sequence[DepthMapFolder], image: tuple[int, int]
) -> list[tuple[str, Float32Array]]:
    """The depths that there are of a frame, by the name of their source, each in its own kind and size."""
    found = [(name, frame.take(name)) for name in DEPTH_SOURCES if name in frame]
    camera: Camera | None = frame.take("camera") or frame.take("depth_camera")
    given = [(f.name, f.of_frame(frame.camera_name, frame.stamp_ns, image, camera)) for f in folders]
    return found + [(name, depth) for name, depth in given if depth is not None]


def _add_skylines(lines: dict[str, SkylineTally], frame: StreamedFrame, image: tuple[int, int]) -> None:
    """Traced sky against the skyline of bare ground, labelled sky against that of the visible surface."""
    ground, surface = frame.take("truth_ground"), frame.take("truth_depth")
    traced, labels = frame.take("traced"), frame.take("labels")
    if ground is not None and traced is not None and traced.shape == image:
        lines["traced"].add(depth_skyline(traced), depth_skyline(ground), round(image[1] / ground.shape[1]))
    if labels is not None and labels.shape == image:
        sky = labels == Label.SKY
        lines["labels"].add(skyline(sky), depth_skyline(surface), round(image[1] / surface.shape[1]))


def _latencies(stream: FrameStream) -> list[LatencyRow]:
    rows = []
    results = [topic.name for topic in _RESULTS]
    for (camera, topic), values in sorted(stream.latencies_ms.items()):
        if topic in results and np.any(values):
            p50, p95 = np.percentile(values, [50, 95])
            rows.append(LatencyRow(camera, topic, len(values), float(p50), float(p95), float(np.max(values))))
    return rows


def _score_terrain(score: BagScore, recorded: Recorded) -> None:
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


def _missed(score: BagScore, folder: DepthMapFolder, maps: Mapping[str, int], example: str) -> str:
    """What a folder of depth maps lacks; empty where it has a map with numbers of every frame with truth."""
    count = maps[folder.name]
    if count == 0:
        return f"{folder.path} has no map of any frame with truth; the first would be {example}"
    if not any(row.source == folder.name for row in score.depth):
        return f"its {count} maps have no number where a true depth is known"
    return "" if count == score.frames else f"{folder.path} has maps of {count} of the {score.frames} frames with truth"


def _lacking(score: BagScore, stream: FrameStream) -> list[str]:
    have = {part for _, part in stream.counts}
    lacking = []
    if score.frames == 0:
        lacking.append("all that is scored on frames: the bag has no truth/depth (`ltm-lab simulate --bag` writes it)")
    for name, topic in DEPTH_SOURCES.items():
        if name not in have:
            lacking.append(f"depth, {name}: the bag has no {topic.name}")
    if len({row.source for row in score.depth}) > 1 and not any(row.against == SHARED for row in score.depth):
        lacking.append("depth, shared: no pixel of a frame has a depth of every source")
    if score.labels is None:
        absent = [t.name for p, t in (("labels", LABELS_IMAGE), ("truth_labels", TRUTH_LABELS)) if p not in have]
        lacking.append(f"labels: the bag has no {' and no '.join(absent) or 'frame with both labels and truth'}")
    measured = {name for name, _ in score.skylines}
    lacking += [f"skyline, {name}: no frame shows one" for name in ("traced", "labels") if name not in measured]
    if not score.latency:
        lacking.append("latency: every log time is its message's stamp, as an offline replay or a simulation writes it")
    return lacking
