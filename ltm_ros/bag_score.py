"""A recorded run scored as a whole against truth: depth, labels, skyline, fuel cells, terrain, latency."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ltm_core.camera import Camera
from ltm_core.errors import LtmError, RecordingError
from ltm_core.fuel.fuel_map_io import read_fuel_map
from ltm_core.fuel.majority import UNSEEN, MajorityFuelMap
from ltm_core.fuel.site_map import site_evidence_map
from ltm_core.fuel.votes import CellVotes
from ltm_core.grid import GridGeometry
from ltm_core.metrics.depth import DepthScore
from ltm_core.metrics.depth_fit import DepthKind, at_pixels_of, fit_to_truth
from ltm_core.metrics.depth_maps_io import DepthMapFolder
from ltm_core.metrics.depth_tally import DepthTally
from ltm_core.metrics.fuel import FuelScore, score_fuel
from ltm_core.metrics.segmentation import SegmentationScore
from ltm_core.metrics.skyline import SkylineScore, SkylineTally, depth_skyline, skyline
from ltm_core.resources import config_path, project_path
from ltm_core.site import Site
from ltm_core.site_io import load_site
from ltm_core.vision.labels import Label, LabelSet
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.camera_info import msg_to_camera
from ltm_msgs_py.image import compressed_to_rgb, msg_to_array, msg_to_depth, msg_to_rgb
from ltm_msgs_py.pose import msg_to_pose
from ltm_msgs_py.votes import msg_to_votes
from ltm_ros.frame_stream import FrameStream, Parts, StreamedFrame
from ltm_ros.recorded_map import last_fuel_map
from ltm_ros.terrain_score import TerrainScore, score_terrain
from ltm_ros.topics import (
    CAMERA_INFO,
    DEPTH_CAMERA_INFO,
    DEPTH_IMAGE,
    FUEL_VOTES,
    FUSED_DEPTH,
    IMAGE_COMPRESSED,
    IMAGE_RAW,
    LABELS_IMAGE,
    NETWORK_DEPTH,
    POSE,
    POSED_POSE,
    TRUTH_CAMERA_INFO,
    TRUTH_DEPTH,
    TRUTH_GROUND_DEPTH,
    TRUTH_LABELS,
)

FUEL_TRUTH = "fuel_truth.tif"


def _mono8(message: Any) -> NDArray[np.uint8]:
    return msg_to_array(message, ("mono8",))


PARTS: Parts = {
    "camera": ((CAMERA_INFO, msg_to_camera),),
    "depth_camera": ((DEPTH_CAMERA_INFO, msg_to_camera),),
    "pose": ((POSE, msg_to_pose), (POSED_POSE, msg_to_pose)),
    "photo": ((IMAGE_COMPRESSED, compressed_to_rgb), (IMAGE_RAW, msg_to_rgb)),
    "traced": ((DEPTH_IMAGE, msg_to_depth),),
    "network": ((NETWORK_DEPTH, msg_to_depth),),
    "fused": ((FUSED_DEPTH, msg_to_depth),),
    "labels": ((LABELS_IMAGE, _mono8),),
    "votes": ((FUEL_VOTES, lambda m: m),),
    "truth_camera": ((TRUTH_CAMERA_INFO, msg_to_camera),),
    "truth_depth": ((TRUTH_DEPTH, msg_to_depth),),
    "truth_ground": ((TRUTH_GROUND_DEPTH, msg_to_depth),),
    "truth_labels": ((TRUTH_LABELS, _mono8),),
}
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
    terrain: TerrainScore | None = None
    latency: list[LatencyRow] = field(default_factory=list)
    lacking: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Recorded:
    """A bag with the site it is of and the folder that may hold its truth rasters."""

    bag: Path
    site_path: Path
    site: Site
    truth: Path
    date: str | None = None
    """Of a simulated site with several: `truth/DATE/` in the truth folder holds its rasters."""

    @classmethod
    def find(cls, bag: Path, site: Path | None = None, truth: Path | None = None, date: str | None = None) -> Recorded:
        """The site: as given, beside or in the bag, or the shipped one that the topics name. Truth: the site's folder.

        Raises RecordingError where no site or date is found, ConfigError on a site that cannot be read.
        """
        path = site or _site_of(bag)
        folder = truth or path.resolve().parent
        dates = sorted(p.name for p in (folder / "truth").glob("*") if p.is_dir())
        if date is None and len(dates) > 1:
            raise RecordingError(f"{folder} holds the truth of {', '.join(dates)}: name the bag's date with --date")
        if date is not None and date not in dates:
            raise RecordingError(f"{folder} holds no truth of {date!r}; it has {', '.join(dates) or 'none'}")
        return cls(bag, path, load_site(path), folder, date)

    @property
    def life_forms(self) -> Path | None:
        """The raster of true class ids on the fuel grid, where there is one."""
        dated = None if self.date is None else self.truth / "truth" / self.date / "life_form.tif"
        return next((file for file in (dated, self.truth / FUEL_TRUTH) if file is not None and file.is_file()), None)

    @property
    def surfaces(self) -> tuple[Path | None, Path | None]:
        """The rasters of the true surface at the bag's date and at the one before it, where there are such."""
        if self.date is None:
            return None, None
        folder = self.truth / "truth"
        before = [path.stem.split("_")[1] for path in folder.glob(f"change_*_{self.date}.tif")]
        rasters = [folder / name / "surface.tif" for name in (self.date, *before[:1])]
        now, *earlier = [raster if raster.is_file() else None for raster in rasters]
        return now, earlier[0] if earlier else None

    def stream(self) -> FrameStream:
        return FrameStream(self.bag, self.site.name, list(self.site.cameras), PARTS)


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
    labels = SegmentationScore.empty(len(label_set))
    for frame in stream.frames(["truth_depth"]):
        score.frames += 1
        image = image_shape(frame, site)
        estimates = _estimates(frame, folders)
        for against, part in TRUTHS.items():
            truth = frame.take(part)
            if truth is not None:
                found = {name: in_metres(depth, kind_of(name, folders), truth, image) for name, depth in estimates}
                for name, metres in found.items():
                    tallies[name, against].add(metres, truth)
                if part == "truth_depth" and len(found) == len(expected) > 1:
                    _add_shared(tallies, found, truth)
        _add_skylines(lines, frame, image)
        truth_labels, given = frame.take("truth_labels"), frame.take("labels")
        if truth_labels is not None and given is not None:
            labels = labels.plus(truth_labels, at_pixels_of(given, image, truth_labels.shape))
    for (name, against), tally in tallies.items():
        if tally.frames:
            score.depth.append(DepthRow(name, against, tally.frames, tally.coverage, tally.scores()))
    score.skylines = [(name, line.score()) for name, line in lines.items() if line.score().columns]
    score.labels = labels if labels.pixels else None
    score.latency = _latencies(stream)
    _score_fuel(score, recorded)
    _score_terrain(score, recorded)
    score.lacking[:0] = _lacking(score, stream, recorded, folders)
    return score


def _add_shared(
    tallies: dict[tuple[str, str], DepthTally], found: dict[str, NDArray[np.float32]], truth: NDArray[np.float32]
) -> None:
    everywhere = np.all([np.isfinite(metres) for metres in found.values()], axis=0)
    for name, metres in found.items():
        tallies[name, SHARED].add(np.where(everywhere, metres, np.float32(np.nan)), truth)


def image_shape(frame: StreamedFrame, site: Site) -> tuple[int, int]:
    """Rows and columns of a frame's image. Raises RecordingError where nothing says them."""
    camera: Camera | None = frame.take("camera") or frame.take("depth_camera")
    if camera is None and (calibration := site.cameras[frame.camera_name].calibration) is not None:
        camera = calibration.camera()
    if camera is None:
        raise RecordingError(
            f"frame {frame.stamp_ns} of {frame.camera_name} has no camera_info, and site {site.name} gives no "
            "calibration: record camera_info too"
        )
    return camera.height, camera.width


def kind_of(source: str, folders: Sequence[DepthMapFolder]) -> DepthKind:
    for folder in folders:
        if folder.name == source:
            return folder.config.kind
    return "metric"


def in_metres(
    depth: NDArray[np.float32], kind: DepthKind, truth: NDArray[np.float32], image: tuple[int, int]
) -> NDArray[np.float32]:
    """A depth image at the truth's pixels, in metres; one without a scale is fitted to the truth."""
    return fit_to_truth(at_pixels_of(depth, image, truth.shape), truth, kind)


def _estimates(frame: StreamedFrame, folders: Sequence[DepthMapFolder]) -> list[tuple[str, NDArray[np.float32]]]:
    found = [(name, frame.take(name)) for name in DEPTH_SOURCES if name in frame]
    for folder in folders:
        depth = folder.read(frame.camera_name, frame.stamp_ns)
        if depth is not None:
            if folder.config.along == "ray":
                depth = _along_axis(depth, frame.take("camera"), folder)
            found.append((folder.name, depth))
    return found


def _along_axis(depth: NDArray[np.float32], camera: Camera | None, folder: DepthMapFolder) -> NDArray[np.float32]:
    if camera is None:
        raise RecordingError(f"{folder.path} gives ranges along rays, but the bag has no camera_info to turn them by")
    cosine = camera.rays()[..., 2].astype(np.float32)
    rows = ((np.arange(depth.shape[0]) + 0.5) * camera.height / depth.shape[0]).astype(np.int64)
    cols = ((np.arange(depth.shape[1]) + 0.5) * camera.width / depth.shape[1]).astype(np.int64)
    return np.asarray(depth * cosine[rows[:, None], cols], np.float32)


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


def _score_fuel(score: BagScore, recorded: Recorded) -> None:
    """The map, the majority vote and the prior, over the cells that a recorded frame voted in."""
    file = recorded.life_forms
    try:
        classes, geometry, labels = last_fuel_map(recorded.bag, recorded.site)
    except RecordingError:
        score.lacking.append("fuel cells: the bag has no fuel_map")
        return
    if file is None:
        score.lacking.append(f"fuel cells: no {FUEL_TRUTH} in {recorded.truth}; name its folder with --truth")
        return
    try:
        truth, grid = read_fuel_map(file)
        vote = majority_map(recorded, geometry, labels)
        if vote is not None:
            unseen = vote == UNSEEN
            score.fuel_vote = score_fuel(vote, geometry, truth, grid, len(labels))
            classes = np.where(unseen, UNSEEN, classes).astype(np.uint8)
            if recorded.site.fuel.prior is not None:
                untouched = site_evidence_map(recorded.site, recorded.site.in_map(geometry), labels).layers().life_form
                prior = np.where(unseen, UNSEEN, untouched).astype(np.uint8)
                score.fuel_prior = score_fuel(prior, geometry, truth, grid, len(labels))
        score.fuel = score_fuel(classes, geometry, truth, grid, len(labels))
    except LtmError as error:
        score.lacking.append(f"fuel cells: {error}")


def majority_map(recorded: Recorded, geometry: GridGeometry, labels: LabelSet) -> NDArray[np.uint8] | None:
    """The majority vote of all recorded votes on `geometry` (in the site's CRS); None where the bag has none."""
    grid = recorded.site.in_map(geometry)
    votes = MajorityFuelMap(grid, len(labels))
    counted = 0
    for one in recorded_votes(recorded, grid, labels):
        votes.add(one)
        counted += 1
    return votes.classes() if counted else None


def recorded_votes(recorded: Recorded, geometry: GridGeometry, labels: LabelSet) -> Iterator[CellVotes]:
    """The votes of a bag, frame by frame; `geometry`: the fuel grid in the map frame. Raises MessageError."""
    for frame in recorded.stream().frames(["votes"]):
        yield msg_to_votes(frame.take("votes"), geometry, labels.names, frame.camera_name)


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


def _lacking(score: BagScore, stream: FrameStream, recorded: Recorded, folders: Sequence[DepthMapFolder]) -> list[str]:
    have = {part for _, part in stream.counts}
    lacking = []
    if score.frames == 0:
        lacking.append("all that is scored on frames: the bag has no truth/depth (`ltm simulate --bag` writes it)")
    for name, topic in DEPTH_SOURCES.items():
        if name not in have:
            lacking.append(f"depth, {name}: the bag has no {topic.name}")
    scored = {row.source for row in score.depth}
    lacking += [
        f"depth, {folder.name}: {folder.path} has no map of any frame with truth"
        for folder in folders
        if folder.name not in scored
    ]
    if score.labels is None:
        absent = [t.name for p, t in (("labels", LABELS_IMAGE), ("truth_labels", TRUTH_LABELS)) if p not in have]
        lacking.append(f"labels: the bag has no {' and no '.join(absent) or 'frame with both labels and truth'}")
    measured = {name for name, _ in score.skylines}
    lacking += [f"skyline, {name}: no frame shows one" for name in ("traced", "labels") if name not in measured]
    if not score.latency:
        lacking.append("latency: every log time is its message's stamp, as an offline replay or a simulation writes it")
    return lacking


def _site_of(bag: Path) -> Path:
    folder = bag.resolve()
    for place in (folder, folder.parent, folder.parent.parent):
        if (place / "site.yaml").is_file():
            return place / "site.yaml"
    names = {topic.split("/")[1] for topic in BagReader(bag).topics() if topic.count("/") > 2}
    for name in sorted(names):
        for shipped in (f"bags/{name}/site.yaml", f"config/sites/{name}.yaml"):
            try:
                return project_path(shipped)
            except LtmError:
                continue
    raise RecordingError(f"{bag}: no site.yaml beside it, and none ships for {', '.join(sorted(names))}: give --site")
