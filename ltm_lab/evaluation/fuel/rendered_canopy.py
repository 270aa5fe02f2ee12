"""Scores cover by labels and heights by depth on rendered sites, in cells of trees that have no prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import BoolArray
from ltm_core.fuel.canopy import stand_heights
from ltm_core.fuel.codes import TreeCanopy
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.votes import VoteCaster
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.raster.dem import Dem
from ltm_core.surface import Reference, SurfaceMap
from ltm_core.surface.config import TerrainConfig
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.evaluation.fuel.canopy_truth_io import CanopyTruth
from ltm_lab.evaluation.terrain.frame_score import Measure
from ltm_lab.evaluation.terrain.hillside_scenes import HOUR_NS
from ltm_lab.evaluation.truth_frames_io import TruthFrame

LEAST_COVER = 10.0
"""% of true canopy that a cell needs for a height."""
_REFRACTION = 0.13
_Values = NDArray[np.floating]


@dataclass(frozen=True)
class MeasuredScore:
    """Of `cells` that were measured: the median error of what was found and of the constant, its median `bias`, and the
    standard deviation of the errors in units of the stated standard error. Of cover in points, of height as a share.
    """

    cells: int
    found: float
    constant: float
    bias: float
    in_sigmas: float


def score_cover(
    frames: Sequence[TruthFrame], dem: Dem, curved: bool, truth: CanopyTruth, network: Segmenter, constant: TreeCanopy
) -> MeasuredScore | None:
    """Of cells of trees that the frames' labels show, as the graph votes them: traced to `dem`, bare earth. `constant`:
    what is known before. None where no such cell is seen.
    """
    tracer = TerrainTracer(dem, curved, _REFRACTION)
    caster = VoteCaster(truth.grid, dem, np.array(network.labels.ground_cover), bend=ray_bend(curved, _REFRACTION))
    evidence = EvidenceMap(truth.grid, None, network.labels)
    for frame in frames:
        traced, labels = tracer.trace(frame.camera, frame.pose).depth(), network.segment(frame.photo).labels
        evidence.add(caster.cast(traced, frame.camera, frame.pose, labels, frame.stamp_ns, frame.camera_name))
    cover, sigma = evidence.label_cover(np.full(truth.cover.shape, constant.cover))
    error = cover - truth.cover
    return _score(error, sigma, constant.cover - truth.cover, truth.trees & np.isfinite(error))


def score_heights(
    frames: Sequence[TruthFrame], dem: Dem, truth: CanopyTruth, measure: Measure, constant: TreeCanopy, looks: int
) -> MeasuredScore | None:
    """Of cells of trees that depth shows to stand on `dem`, bare earth: no raster of tree tops is given. Each frame is
    looked at `looks` times, an hour apart. None where no such cell is seen.
    """
    reference = Reference.of(dem, None)
    surface = SurfaceMap(reference, TerrainConfig(), sorted({frame.camera_name for frame in frames}))
    for number, frame in enumerate([*frames] * looks):
        surface.add(replace(measure(frame)[0], stamp_ns=frame.stamp_ns + number * HOUR_NS))
    surface.decide()
    height, sigma = stand_heights(surface, truth.grid, np.full(truth.height.shape, constant.height))
    with np.errstate(divide="ignore", invalid="ignore"):
        error, spread, flat = (a / truth.height for a in (height - truth.height, sigma, constant.height - truth.height))
    return _score(error, spread, flat, truth.trees & (truth.cover >= LEAST_COVER) & np.isfinite(error))


def _score(error: _Values, sigma: _Values, constant: _Values, cells: BoolArray) -> MeasuredScore | None:
    if not cells.any():
        return None
    error, sigma, constant = error[cells], sigma[cells], constant[cells]
    return MeasuredScore(
        int(cells.sum()),
        float(np.median(np.abs(error))),
        float(np.median(np.abs(constant))),
        float(np.median(error)),
        float(np.std(error / sigma)),
    )
