"""Smoke trials: their geometry, and what is made of them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes.located import hills

from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.turn_evidence import TURNS, TurnEvidence
from ltm_core.visibility.point_visibility import PointVisibility, project
from ltm_lab.evaluation.locating.smoke_score import Case, Trial, smoke_trials
from ltm_lab.evaluation.locating.smoke_sites import MAST, ranged_mountains, smoke_site
from ltm_lab.evaluation.locating.smoke_trials import CAMERA, Plume, PoseErrors, seen_plume, sighting
from ltm_lab.evaluation.locating.summary import SmokeSummary
from ltm_lab.evaluation.locating.turned_trials import EXACTLY, NamingScore, TurnedCase, turned_cases

pytestmark = pytest.mark.kernel

TOWER = np.array([0.0, 0.0, 130.0])


def test_of_a_plume_behind_a_crest_the_top_is_seen() -> None:
    sight = PointVisibility(hills(), curvature=False)
    plume = Plume(np.array([0.0, 2000.0, 0.0]), np.zeros(2), 150.0)
    seen = seen_plume(sight, plume, TOWER)
    assert seen is not None
    assert seen.hidden == pytest.approx(70.0, abs=5.0)  # 130 - 30 * 2: the line over the crest, and the axis in steps
    assert seen.range == 2000
    assert seen_plume(sight, replace(plume, height=80.0), TOWER) is None
    low = seen_plume(sight, replace(plume, foot=np.array([0.0, 500.0, 0.0])), TOWER)
    assert low is not None
    assert low.hidden == 0


@pytest.mark.parametrize("boxed", [False, True])
def test_a_mark_is_where_the_plume_is_first_seen(boxed: bool) -> None:
    sight = PointVisibility(hills(), curvature=False)
    seen = seen_plume(sight, Plume(np.array([30.0, 500.0, 0.0]), np.array([0.1, 0.0]), 90.0), TOWER)
    assert seen is not None
    exact = PoseErrors(1e-9, 1e-9)
    marks = [sighting(np.random.default_rng(k), "a", seen, 0.0, exact, LocatingConfig(), boxed) for k in range(20)]
    off = []
    for mark in (mark for mark in marks if mark is not None):
        u, v = project(CAMERA, mark.pose, seen.seen[:1], 0.0)[0]
        off.append(mark.mark.pixels[:, 1].max() - v)
        assert mark.mark.pixels[:, 0].min() - 8 < u < mark.mark.pixels[:, 0].max() + 8
    assert len(off) > 5
    assert abs(np.mean(off)) < 6.0


def test_sites_differ_from_their_model_by_what_is_asked() -> None:
    site = smoke_site("small", ranged_mountains(3, 330, 30.0), 3.0, 5)
    off = site.truth.elevation - site.model.elevation
    assert off.std() == pytest.approx(3.0, rel=0.01)
    assert np.corrcoef(off[:, :-1].ravel(), off[:, 1:].ravel())[0, 1] > 0.8
    ground = site.truth.elevation_at(site.towers[:, 0], site.towers[:, 1])
    assert site.towers[:, 2] - ground == pytest.approx(np.full(len(ground), MAST), abs=1e-3)


def test_trials_are_run_and_summed_up() -> None:
    site = smoke_site("small", ranged_mountains(3, 330, 30.0), 3.0, 5)
    config = LocatingConfig(dem_sigma=3.0)
    trials = list(smoke_trials(site, (Case.ONE,), 3, PoseErrors(0.06), config, False, 1))
    again = list(smoke_trials(site, (Case.ONE,), 3, PoseErrors(0.06), config, False, 1))
    assert [trial.error for trial in trials] == [trial.error for trial in again]
    trials += smoke_trials(site, (Case.TURNED,), 1, PoseErrors(0.06), config, False, 1)
    assert [bool(trial.wrong) for trial in trials] == [False, False, False, True]
    one = SmokeSummary.of(trials)
    assert one is not None
    assert one.count == 4
    assert one.error == pytest.approx(np.median([trial.error for trial in trials]))
    assert SmokeSummary.of([]) is None


def test_a_refused_answer_counts_as_a_miss() -> None:
    found = Trial("a", "one camera", False, 2e3, 0.0, 10.0, 9.0, 0.3, True, True, 50.0, 9.0, 1, True, "", "", 8.0)
    refused = replace(found, error=math.nan, in_50=False, in_95=False, densest=1.0, unlocated="sky")
    one = SmokeSummary.of([found, refused])
    assert one is not None
    assert (one.unlocated, one.error, one.ellipse_95, one.densest_95) == (1, 10.0, 0.5, 0.5)


def turned_case(turned: str, *turns_deg: float) -> TurnedCase:
    """Fires whose marks say that `a` is turned by 2 degrees, or that `b` is by another angle each time."""
    fires = []
    for other in turns_deg:
        off = {"a": TURNS - math.radians(2.0), "b": TURNS - math.radians(other)}
        ratios = {name: np.logaddexp(15.0 - 0.5 * (at / 0.002) ** 2, -9.0) for name, at in off.items()}
        fires.append(TurnEvidence(ratios, {"a": 0.001, "b": 0.001}, {}))
    return TurnedCase("site", turned, 2.0 if turned else 0.0, tuple(fires))


def test_naming_is_scored_by_fires() -> None:
    cases = [turned_case("a", 1.5, 0.3), turned_case("b", 1.5, 0.3), turned_case("", 1.5, 0.3), turned_case("a")]
    one, two = (NamingScore.of(cases, fires, 0.9) for fires in (1, 2))
    assert (one.count, one.named, one.wrongly_named, one.suspect) == (4, 0.0, 0.0, 0.25)
    assert (two.named, two.wrongly_named, two.suspect) == (0.25, 0.5, 0.25)
    assert two.off_deg == pytest.approx(0.0, abs=0.05)
    assert [case.told for case in cases] == [True, False, False, False]
    told = NamingScore.of(cases[:1], 2, 0.9, slips=EXACTLY)
    assert (told.named, told.off_deg) == (1.0, pytest.approx(0.0, abs=0.01))


@pytest.mark.slow
def test_a_turned_camera_is_named_by_three_fires() -> None:
    site = smoke_site("seed 1", ranged_mountains(1, 700, 25.0), 2.5, 1)
    config = LocatingConfig(dem_sigma=2.5)
    cases = list(turned_cases(site, 2, 3, True, PoseErrors(0.06), config, 1))
    assert len(cases) == 2
    assert all(2 <= len(case.fires) <= 3 for case in cases)  # a mark that no ground explains is refused
    assert NamingScore.of(cases, 3, 0.9).suspect == 1.0
    none = list(turned_cases(site, 1, 2, False, PoseErrors(0.06), config, 1))
    assert NamingScore.of(none, 2, 0.9).wrongly_named == 0.0
