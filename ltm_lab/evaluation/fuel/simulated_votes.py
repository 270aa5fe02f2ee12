"""Votes of simulated frames, formed as the graph forms them, with the true life forms of their cells."""

from dataclasses import dataclass
from pathlib import Path

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.class_map import read_fuel_map
from ltm_core.fuel.votes import CellVotes, VoteCaster
from ltm_core.site.sections import FuelConfig
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.segmenter import Segmenter
from ltm_lab.frames.truth_frames_io import is_curved, open_dem, read_truth_frames, scenario_name, site_frame


@dataclass(frozen=True, eq=False)
class SimulatedVotes:
    """`votes`: of each frame. `truth`: (H, W) life forms of their grid's cells, 255 none. `scenario`: its name."""

    scenario: str
    votes: list[CellVotes]
    truth: UInt8Array


def simulated_votes(folder: Path, segmenter: Segmenter, labels: LabelSet) -> SimulatedVotes:
    """Return the votes of all frames of a folder of `ltm-lab simulate` with one date: each photo is labelled by the
    network and traced over the outdated DEM. Raises RecordingError for a folder of another kind."""
    rasters = sorted((folder / "truth").glob("*/life_form.tif"))
    if len(rasters) != 1:
        raise RecordingError(f"{folder} must hold the truth of one date, found that of {len(rasters)}")
    truth, grid = read_fuel_map(rasters[0])
    frame = site_frame(folder)
    grid = grid.translated(-frame.x_origin, -frame.y_origin)
    dem = open_dem(folder)
    tracer = TerrainTracer(dem, is_curved(folder), possible=NOTHING_BEYOND)
    caster = VoteCaster(grid, dem, labels.votes_table[: len(labels)], FuelConfig().max_range, tracer.bend)
    votes = []
    for shot in read_truth_frames(folder):
        ranges = tracer.trace(shot.camera, shot.pose).range
        seen = segmenter.segment(shot.photo)
        votes.append(
            caster.cast(
                ranges,
                shot.camera,
                shot.pose,
                seen.labels,
                shot.stamp_ns,
                shot.camera_name,
                seen.confidence,
                along_axis=False,
            )
        )
    return SimulatedVotes(scenario_name(folder), votes, truth)
