"""`ltm-lab eval BAG`: scores the fuel map that a recorded run ended with, beside the majority vote and the prior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import LtmError, RecordingError
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.cell_counts import UNSEEN, MajorityFuelMap
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.fuel_map_io import read_fuel_map
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_lab.evaluation.fuel.map_score import MapScore, score_map
from ltm_lab.evaluation.metrics.fuel import FuelScore, on_grid, score_fuel
from ltm_msgs_py.pointcloud import msg_to_votes
from ltm_ros.recordings.frame_stream import StreamedFrame
from ltm_ros.recordings.recorded_run import FUEL_TRUTH, Recorded, last_fuel_map


@dataclass(frozen=True)
class FuelScores:
    """Of the cells that a recorded frame voted in: the map, the majority vote of the same votes, the map that the
    system started from, and what of it the map has changed; None where the bag or the site lacks it."""

    fuel: FuelScore | None = None
    vote: FuelScore | None = None
    prior: FuelScore | None = None
    changes: MapScore | None = None


class FuelTally:
    """Takes the votes of a bag's frames as they come, and scores the map that the bag ended with.

    `lacking`: what keeps it from scoring, where something does.
    """

    def __init__(self, recorded: Recorded) -> None:
        self._recorded = recorded
        self.lacking: str | None = None
        self._votes: MajorityFuelMap | None = None
        self._counted = 0
        try:
            self._classes, self._geometry, self._labels = last_fuel_map(recorded.bag, recorded.site)
        except RecordingError:
            self.lacking = "fuel cells: the bag has no fuel_map"
            return
        if recorded.life_forms is None:
            self.lacking = f"fuel cells: no {FUEL_TRUTH} in {recorded.truth}; name its folder with --truth"
            return
        self._votes = MajorityFuelMap(recorded.site.in_map(self._geometry), len(self._labels))

    def add(self, frame: StreamedFrame) -> None:
        """The votes of one frame, where it has any. A frame whose votes cannot be read ends the scoring of fuel."""
        message = frame.take("votes") if self._votes is not None else None
        if message is None or self._votes is None:
            return
        try:
            self._votes.add(msg_to_votes(message, self._votes.geometry, self._labels.names, frame.camera_name))
            self._counted += 1
        except LtmError as error:
            self._votes, self.lacking = None, f"fuel cells: {error}"

    def scores(self) -> FuelScores:
        """The scores of all that was added."""
        file = self._recorded.life_forms
        if self._votes is None or file is None:
            return FuelScores()
        try:
            truth, grid = read_fuel_map(file)
            classes, vote, prior, changes = self._classes, None, None, None

            def scored(values: UInt8Array) -> FuelScore:
                return score_fuel(values, self._geometry, truth, grid, len(self._labels))

            if self._counted:
                majority = self._votes.classes()
                unseen = majority == UNSEEN
                classes = np.where(unseen, UNSEEN, classes).astype(np.uint8)
                vote = scored(majority)
                empty = self._untouched()
                if empty.prior is not None:
                    prior = scored(np.where(unseen, UNSEEN, empty.layers().life_form).astype(np.uint8))
                    true = on_grid(truth, grid, self._geometry)
                    changes = score_map("fuel map", self._classes, true, empty.prior.codes, ~unseen)
            return FuelScores(scored(classes), vote, prior, changes)
        except LtmError as error:
            self.lacking = f"fuel cells: {error}"
            return FuelScores()

    def _untouched(self) -> EvidenceMap:
        site = self._recorded.site
        return site_evidence_map(site, site.in_map(self._geometry), self._labels)
