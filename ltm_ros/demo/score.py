"""Score a recorded run against truth: depth, labels, fuel and poses."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ltm_core.base.errors import LtmError, RecordingError
from ltm_core.base.resources import config_path
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.class_map import UNSEEN, MajorityFuelMap, read_fuel_map
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.scoring.fuel import FuelScore, MapScore, on_grid, score_fuel, score_map
from ltm_core.scoring.labels import DepthScore, DepthTally, SegmentationScore, at_pixels_of
from ltm_core.site.site import Site
from ltm_core.vision.labels import LabelSet
from ltm_ros.recordings.frame_stream import FrameStream, StreamedFrame
from ltm_ros.recordings.recorded_run import FUEL_TRUTH, Recorded, image_shape, last_fuel_map, recorded_votes

DEPTH_SOURCES = ("traced", "network", "fused")
TRUTHS = {"visible surface": "truth_depth", "bare ground": "truth_ground"}
SHARED = "visible surface, shared pixels"
"""Pixels for which every source has a depth; used to compare the sources."""


@dataclass(frozen=True)
class DepthRow:
    """One source of depth compared with one truth; `scores`: by range, then over all. `coverage`: see DepthTally."""

    source: str
    against: str
    frames: int
    coverage: float
    scores: Sequence[DepthScore]


@dataclass(eq=False)
class RunScore:
    """The scores of a recorded run; `lacking` lists what could not be scored, with the reason.

    On the cells of `fuel`: `fuel_vote` of a majority vote over the same votes, `fuel_prior` of the prior map,
    `fuel_changes`: detected and false changes."""

    bag: Path
    site: Site
    class_names: tuple[str, ...]
    frames: int = 0
    depth: list[DepthRow] = field(default_factory=list)
    labels: SegmentationScore | None = None
    fuel: FuelScore | None = None
    fuel_vote: FuelScore | None = None
    fuel_prior: FuelScore | None = None
    fuel_changes: MapScore | None = None
    lacking: list[str] = field(default_factory=list)


class RunTally:
    """Adds the frames of a recorded run to its scores."""

    def __init__(self, recorded: Recorded, stream: FrameStream) -> None:
        self._recorded = recorded
        self._label_set = LabelSet.load(config_path(recorded.site.labels))
        self._expected = sum(stream.has(name) for name in DEPTH_SOURCES)
        self._tallies = {(name, against): DepthTally() for name in DEPTH_SOURCES for against in (*TRUTHS, SHARED)}
        self._labels = SegmentationScore.empty(len(self._label_set))
        self._frames = 0

    def add(self, frame: StreamedFrame) -> None:
        """Score one frame."""
        if "truth_depth" not in frame:
            return
        self._frames += 1
        image = image_shape(frame, self._recorded.site)
        for against, part in TRUTHS.items():
            truth = frame.take(part)
            if truth is None:
                continue
            depths = {
                name: at_pixels_of(frame.take(name), image, truth.shape) for name in DEPTH_SOURCES if name in frame
            }
            for name, metres in depths.items():
                self._tallies[name, against].add(metres, truth)
            if part == "truth_depth" and len(depths) == self._expected > 1:
                everywhere = np.all([np.isfinite(metres) for metres in depths.values()], axis=0)
                for name, metres in depths.items():
                    self._tallies[name, SHARED].add(np.where(everywhere, metres, np.float32(np.nan)), truth)
        truth_labels, given = frame.take("truth_labels"), frame.take("labels")
        if truth_labels is not None and given is not None:
            self._labels = self._labels.plus(truth_labels, at_pixels_of(given, image, truth_labels.shape))

    def score(self) -> RunScore:
        """Return the scores of all frames added so far."""
        score = RunScore(self._recorded.bag, self._recorded.site, self._label_set.names, self._frames)
        score.depth = [
            DepthRow(name, against, tally.frames, tally.coverage, tally.scores())
            for (name, against), tally in self._tallies.items()
            if tally.coverage > 0
        ]
        score.labels = self._labels if self._labels.pixels else None
        _score_fuel(score, self._recorded)
        return score


def _score_fuel(score: RunScore, recorded: Recorded) -> None:
    """Score the last fuel map of a bag over the cells with votes, or add to `lacking` why it cannot be scored."""
    try:
        stored, geometry, labels = last_fuel_map(recorded.bag, recorded.site)
    except RecordingError:
        score.lacking.append("fuel cells: the bag has no fuel_map")
        return
    if recorded.life_forms is None:
        score.lacking.append(f"fuel cells: no {FUEL_TRUTH} in {recorded.truth}; name its folder with --truth")
        return
    try:
        truth, grid = read_fuel_map(recorded.life_forms)
        own, classes = recorded.site.in_map(geometry), stored

        def scored(values: UInt8Array) -> FuelScore:
            return score_fuel(values, geometry, truth, grid, len(labels))

        votes = MajorityFuelMap(own, len(labels))
        for frame in recorded_votes(recorded, own, labels):
            votes.add(frame)
        if votes.totals.any():
            majority = votes.classes()
            unseen = majority == UNSEEN
            classes = np.where(unseen, UNSEEN, stored).astype(np.uint8)
            score.fuel_vote = scored(majority)
            empty = site_evidence_map(recorded.site, own, labels)
            if empty.prior is not None:
                score.fuel_prior = scored(np.where(unseen, UNSEEN, empty.layers().life_form).astype(np.uint8))
                true = on_grid(truth, grid, geometry)
                score.fuel_changes = score_map("fuel map", stored, true, empty.prior.codes, ~unseen)
        score.fuel = scored(classes)
    except LtmError as error:
        score.lacking.append(f"fuel cells: {error}")


def score_run(recorded: Recorded) -> RunScore:
    """Score all frames that carry truth. Raises LtmError if the bag cannot be read."""
    stream = FrameStream(recorded.bag, recorded.site)
    tally = RunTally(recorded, stream)
    for frame in stream.frames():
        tally.add(frame)
    return tally.score()
