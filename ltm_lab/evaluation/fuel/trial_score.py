"""Runs one trial and scores the evidence map and the majority vote on it."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.fuel.cell_counts import UNSEEN, MajorityFuelMap
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.label_errors import LabelErrors
from ltm_core.fuel.life_form import LifeForm
from ltm_core.fuel.rules import FusionRules
from ltm_core.raster.dem import Dem
from ltm_core.scoring.fuel_change import MapScore, score_map
from ltm_core.vision.labels import LabelSet
from ltm_lab.evaluation.fuel.trial import Trial, frames
from ltm_lab.evaluation.fuel.trial_country import make_world


@dataclass(frozen=True)
class TrialScore:
    """Of one trial and seed; shares of cells that any pixel votes in.

    `flipped`: of the patch's cells, those that became trees; `flipped_well_seen`: of those among them with evidence
    enough for a change. `false_flips`: of all other cells, those that changed to a wrong life form. `code_kept`: of
    unchanged cells and cells that nobody saw, those with the prior's code. `ours`, `vote`, `prior`: cells of the right
    life form. `vote_in_patch`: the same of the vote, in the patch. `add_ms`: processor time a frame. `changes`: of the
    patch and of what else the prior has wrong, by the map's life forms; None without a prior.
    """

    trial: str
    seed: int
    frames: int
    seen_cells: int
    patch_cells: int
    flipped: float
    flipped_well_seen: float
    false_flips: float
    code_kept: float
    ours: float
    vote: float
    prior: float
    vote_in_patch: float
    add_ms: float
    changes: MapScore | None

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def run_trial(
    trial: Trial, seed: int, errors: LabelErrors, labels: LabelSet, rules: FusionRules, dem: Dem | None = None
) -> TrialScore:
    """One country, one set of frames, and both maps made of them."""
    world = make_world(seed, trial.prior_wrong, dem)
    known = trial.known(errors)
    prior = world.prior if trial.has_prior else None
    ours = EvidenceMap(world.geometry, prior, labels, rules, known)
    vote = MajorityFuelMap(world.geometry, len(labels))
    spent, count = 0.0, 0
    for votes in frames(world, trial, errors, labels, seed):
        vote.add(votes)
        begin = time.process_time()
        ours.add(votes)
        spent += time.process_time() - begin
        count += 1
    layers = ours.layers()
    voted = vote.classes()
    before = EvidenceMap(world.geometry, world.prior, labels, rules, known).layers().life_form
    seen = voted != UNSEEN
    patch = world.patch & seen
    elsewhere = seen & ~world.patch
    flipped = layers.changed & (layers.life_form == LifeForm.TREE)
    wrong = layers.changed & (layers.life_form != world.truth)

    def right(forms: UInt8Array, cells: BoolArray) -> float:
        return float((forms == world.truth)[cells].mean()) if cells.any() else float("nan")

    kept = (layers.code == layers.prior)[~layers.changed] if trial.has_prior else np.ones(1, bool)
    return TrialScore(
        trial=trial.name,
        seed=seed,
        frames=count,
        seen_cells=int(seen.sum()),
        patch_cells=int(patch.sum()),
        flipped=_share(flipped, patch),
        flipped_well_seen=_share(flipped, patch & (layers.evidence >= rules.min_evidence)),
        false_flips=_share(wrong, elsewhere),
        code_kept=float(kept.mean()),
        ours=right(layers.life_form, seen),
        vote=right(voted, seen),
        prior=right(before, seen),
        vote_in_patch=right(voted, patch),
        add_ms=1e3 * spent / max(count, 1),
        changes=None if prior is None else score_map(trial.name, layers.life_form, world.truth, prior.codes, seen),
    )


def _share(chosen: BoolArray, among: BoolArray) -> float:
    return float(chosen[among].mean()) if among.any() else float("nan")
