from dataclasses import replace

import numpy as np
import pytest
from scenes.located import hills

from ltm_core.locating.settings import LocatingConfig
from ltm_core.visibility.point_visibility import PointVisibility, project
from ltm_lab.evaluation.locating.smoke_score import Case, SmokeSummary, smoke_trials
from ltm_lab.evaluation.locating.smoke_sites import ranged_mountains, smoke_site
from ltm_lab.evaluation.locating.smoke_trials import CAMERA, Plume, PoseErrors, seen_plume, sighting

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


def test_trials_are_run_and_summed_up() -> None:
    site = smoke_site("small", ranged_mountains(3, 330, 30.0), 3.0, 5)
    config = LocatingConfig(dem_sigma=3.0)
    trials = list(smoke_trials(site, (Case.ONE,), 3, PoseErrors(0.06), config, False, 1))
    again = list(smoke_trials(site, (Case.ONE,), 3, PoseErrors(0.06), config, False, 1))
    assert [trial.place.error for trial in trials] == [trial.place.error for trial in again]
    trials += smoke_trials(site, (Case.TURNED,), 1, PoseErrors(0.06), config, False, 1)
    assert [bool(trial.wrong) for trial in trials] == [False, False, False, True]
    one = SmokeSummary.of(trials)
    assert one.count == 4
    assert one.error == pytest.approx(np.median([trial.place.error for trial in trials]))
