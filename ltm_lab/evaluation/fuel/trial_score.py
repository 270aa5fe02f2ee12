"""Runs trials and scores the evidence map and the majority vote on them."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.fuel.class_map import UNSEEN, MajorityFuelMap
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.label_errors import LabelErrors
from ltm_core.fuel.label_measurement import measure_labels
from ltm_core.fuel.life_form import FORMS, LifeForm, label_forms
from ltm_core.fuel.rules import FusionRules
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.raster.dem import Dem
from ltm_core.scoring.fuel import MapScore, score_map
from ltm_core.vision.labels import LabelSet
from ltm_lab.evaluation.fuel.trial import Trial, frames
from ltm_lab.evaluation.fuel.trial_country import World, make_world

_WELL_SEEN = 2.0
"""Evidence of a well seen cell."""
RARE = 0.01
"""Share of cells that truly change in a year or two, at which reports of change are judged too."""


def users_accuracy(score: MapScore, prevalence: float | None = None) -> float:
    """Return the share of reported changes that are right if this share of cells has changed and changes are reported
    as often as here; None: as many as here. NaN without reports or truth.

    Source: Olofsson et al. (2014), Good practices for estimating area and assessing accuracy of land change."""
    changed = score.prevalence if prevalence is None else prevalence
    right = changed * score.found.value
    false = (1 - changed) * score.false_flips.value if changed < 1 else 0.0
    reported = right + changed * score.mistaken.value + false
    return right / reported if reported > 0 else float("nan")


@dataclass(frozen=True)
class FuelJob:
    """A trial on one seed, with `level` times the wrong labels of a network. `terrain`: None for a synthetic one."""

    trial: Trial
    seed: int
    level: float
    errors: LabelErrors
    terrain: Path | None


@dataclass(frozen=True)
class TrialScore:
    """Scores of one trial and seed, as shares of the cells that any pixel votes in.

    `flipped`: of the patch's cells, those that became trees; `flipped_well_seen`: the same of those with evidence
    enough for a change. `false_flips`: of all other cells, those that changed to a wrong life form. `code_kept`: of
    unchanged and unseen cells, those with the prior's code. `ours`, `vote`, `prior`: cells of the right life form.
    `add_ms`: processor time of a frame. Of the reported changes (NaN without a prior): `changed`, the share of cells
    that truly changed; `found`, the producer's accuracy; `users`, the user's accuracy, and that at a share of RARE."""

    trial: str
    seed: int
    level: float
    frames: int
    flipped: float
    flipped_well_seen: float
    false_flips: float
    code_kept: float
    ours: float
    vote: float
    prior: float
    add_ms: float
    changed: float
    found: float
    users: float
    users_rare: float


def scaled(errors: LabelErrors, level: float) -> LabelErrors:
    """Return the errors of a network with `level` times the share of wrong labels, at most all but a tenth of a
    form's."""
    wrong = errors.shares * (1 - np.eye(FORMS))
    factor = np.minimum(level, 0.9 / np.maximum(wrong.sum(axis=1, keepdims=True), 1e-9))
    shares = wrong * factor
    return replace(errors, shares=shares + np.diag(1 - shares.sum(axis=1)))


def measured(votes: list[CellVotes], world: World, labels: LabelSet, rules: FusionRules) -> LabelErrors:
    """Return the errors of a network by its votes and the prior map alone."""

    def changes(errors: LabelErrors) -> UInt8Array:
        evidence = EvidenceMap(world.geometry, world.prior, labels, rules, errors)
        for frame in votes:
            evidence.add(frame)
        layers = evidence.layers()
        return np.where(layers.changed, layers.life_form, 0).astype(np.uint8)

    codes, forms = world.prior.codes, label_forms(labels)
    return measure_labels(votes, codes, forms, rules.context_cells, changes, None, "votes of the trial")


def run_fuel_job(job: FuelJob) -> list[TrialScore]:
    """Make a country and its frames, and score both maps that are made of them."""
    trial, seed, rules, labels = job.trial, job.seed, FusionRules(), LabelSet.load()
    errors = scaled(job.errors, job.level)
    world = make_world(seed, trial.prior_wrong, _ground(job.terrain))
    known = trial.known(errors)
    prior = world.prior if trial.has_prior else None
    ours = EvidenceMap(world.geometry, prior, labels, rules, known)
    vote = MajorityFuelMap(world.geometry, len(labels))
    spent, count = 0.0, 0
    taken = list(frames(world, trial, errors, labels, seed))
    if not trial.measured:
        known = measured(taken, world, labels, rules)
        ours = EvidenceMap(world.geometry, prior, labels, rules, known)
    for votes in taken:
        vote.add(votes)
        begin = time.process_time()
        ours.add(votes)
        spent += time.process_time() - begin
        count += 1
    layers, voted = ours.layers(), vote.classes()
    before = EvidenceMap(world.geometry, world.prior, labels, rules, known).layers().life_form
    seen = voted != UNSEEN
    patch = world.patch & seen
    flipped = layers.changed & (layers.life_form == LifeForm.TREE)
    kept = (layers.code == layers.prior)[~layers.changed] if trial.has_prior else np.ones(1, bool)
    score = score_map(trial.name, layers.life_form, world.truth, None if prior is None else prior.codes, seen)
    accuracy = score.prevalence, score.found.value, users_accuracy(score), users_accuracy(score, RARE)
    changed, found, users, users_rare = accuracy if prior is not None else [float("nan")] * 4
    right, vote_right, prior_right = (_share(forms == world.truth, seen) for forms in (layers.life_form, voted, before))
    return [
        TrialScore(
            trial.name,
            seed,
            job.level,
            count,
            _share(flipped, patch),
            _share(flipped, patch & (layers.evidence >= _WELL_SEEN)),
            _share(layers.changed & (layers.life_form != world.truth), seen & ~world.patch),
            float(kept.mean()),
            right,
            vote_right,
            prior_right,
            1e3 * spent / max(count, 1),
            changed,
            found,
            users,
            users_rare,
        )
    ]


def _share(chosen: BoolArray, among: BoolArray) -> float:
    return float(chosen[among].mean()) if among.any() else float("nan")


def _ground(path: Path | None) -> Dem | None:
    if path is None:
        return None
    opened = Dem.open(path)
    x_min, y_min, x_max, y_max = opened.geometry.bounds
    return opened.in_frame(SiteFrame(str(opened.geometry.crs), (x_min + x_max) / 2, (y_min + y_max) / 2))
