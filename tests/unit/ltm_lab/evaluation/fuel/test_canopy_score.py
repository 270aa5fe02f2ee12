"""Canopy of changed cells in exact scenes: better than what the map had, and than the constant."""

from __future__ import annotations

import pytest

from ltm_core.fuel.codes import FuelClimate
from ltm_lab.evaluation.fuel.canopy_score import confirmed_of, score_canopy
from ltm_lab.evaluation.terrain.hillside_scenes import SceneConditions, trial


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["felled", "growth"])
def test_what_is_seen_is_nearer_to_the_truth_than_what_was_known(scene: str) -> None:
    found = trial(scene, 23)
    conditions = SceneConditions(looks=4, seed=23)
    confirmed = confirmed_of(found, conditions)
    scores = {s.source: s for s in score_canopy(found, confirmed, FuelClimate.named("dry").canopy, conditions)}
    seen = scores["seen"]
    assert seen.cells > 5
    assert seen.cover <= 15.0
    assert seen.cover < min(scores["as given"].cover, scores["constant"].cover)
    if seen.wooded:
        assert seen.height <= 0.25
        assert seen.height < min(scores["as given"].height, scores["constant"].height)


@pytest.mark.slow
def test_labels_say_what_is_left_of_a_burnt_stand() -> None:
    found, conditions = trial("burn", 24), SceneConditions(looks=4, seed=24)
    confirmed = confirmed_of(found, conditions)
    scores = {s.source: s for s in score_canopy(found, confirmed, FuelClimate.named("dry").canopy, conditions)}
    seen = scores["seen"]
    assert seen.cells > 5
    assert seen.cover <= 15.0
    assert seen.cover < min(score.cover for source, score in scores.items() if source != "seen")
    assert seen.height <= 0.25
