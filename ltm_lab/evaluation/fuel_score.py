"""`ltm-lab eval fuel BAG`: score the fuel map of a recording beside the majority vote and the prior."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ltm_core.base.errors import LtmError, RecordingError
from ltm_core.base.resources import config_path
from ltm_core.base.types import Int64Array
from ltm_core.fuel.class_map import UNSEEN, MajorityFuelMap, read_fuel_map
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.label_errors import LabelCorrelation, LabelErrors
from ltm_core.fuel.life_form import label_forms
from ltm_core.fuel.votes import CellVotes
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.scoring.fuel import MapScore, on_grid, score_map
from ltm_core.site.networks import site_label_errors
from ltm_core.vision.labels import LabelSet
from ltm_lab.evaluation.fuel.label_correlation import label_correlation
from ltm_ros.recordings.recorded_run import FUEL_TRUTH, Recorded, recorded_votes

REPEAT_S = 60.0
"""Seconds from one repetition of a recording to the next, where it is counted again and again."""


@dataclass(frozen=True, eq=False)
class FuelBagScore:
    """`maps`: the evidence, the same after the recording has come again for some hours, the vote, the prior.

    `unjustified`: cells that only the repetitions changed. `errors`: what was known of the network. `correlation`: of
    its errors in this recording; `lacking` says why it is not known. `cells`: by [true form, commonest label]."""

    frames: int
    maps: list[MapScore]
    unjustified: int
    errors: LabelErrors
    correlation: LabelCorrelation | None
    lacking: str
    cells: Int64Array | None


def score_fuel_bag(recorded: Recorded, repeat_hours: float = 0.0) -> FuelBagScore:
    """Count the votes of a bag into the site's empty map, and score it. Raises RecordingError where it has none, and
    without truth."""
    site = recorded.site
    labels = LabelSet.load(config_path(site.labels))
    grid = site.fuel_geometry(site.open_dem())
    if recorded.life_forms is None:
        raise RecordingError(f"no {FUEL_TRUTH} in {recorded.truth}; name its folder with --truth")
    truth = on_grid(*read_fuel_map(recorded.life_forms), site.in_crs(grid))
    frames = list(recorded_votes(recorded, grid, labels))
    if not frames:
        raise RecordingError(
            f"{recorded.bag} has no votes; run the graph on it with `ltm replay {recorded.bag} --record OUT`, score OUT"
        )
    vote = MajorityFuelMap(grid, len(labels))
    for one in frames:
        vote.add(one)
    seen = vote.classes() != UNSEEN
    empty = site_evidence_map(site, grid, labels)
    prior = None if empty.prior is None else empty.prior.codes
    once = _counted(site_evidence_map(site, grid, labels), frames)
    layers = once.layers()
    shown = {"evidence": layers.life_form}
    unjustified = 0
    if repeat_hours > 0:
        often = _counted(once, _again(frames, repeat_hours)).layers()
        unjustified = int((often.changed & ~layers.changed).sum())
        shown[f"evidence, {repeat_hours:g} h of the same frames"] = often.life_form
    shown |= {"the paper's vote": vote.classes()} | ({} if prior is None else {"prior alone": empty.layers().life_form})
    errors = site_label_errors(site)
    reach = site.fuel.fusion.context_cells
    correlation, cells, lacking = None, None, ""
    try:
        correlation, cells = label_correlation(frames, truth, label_forms(labels), errors, reach)
    except LtmError as error:
        lacking = str(error)
    maps = [score_map(name, forms, truth, prior, seen) for name, forms in shown.items()]
    return FuelBagScore(len(frames), maps, unjustified, errors, correlation, lacking, cells)


def _counted(evidence: EvidenceMap, frames: Sequence[CellVotes]) -> EvidenceMap:
    for frame in frames:
        evidence.add(frame)
    return evidence


def _again(frames: Sequence[CellVotes], hours: float) -> list[CellVotes]:
    """The same frames with later stamps, over and over."""
    span = max(f.stamp_ns for f in frames) - min(f.stamp_ns for f in frames)
    step = max(int(REPEAT_S * 1e9), span + 10**9)
    times = range(1, int(hours * 3600e9) // step + 1)
    return [replace(frame, stamp_ns=frame.stamp_ns + k * step) for k in times for frame in frames]
