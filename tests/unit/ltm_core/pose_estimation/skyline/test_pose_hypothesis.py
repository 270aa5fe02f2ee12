import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose, pose_covariance
from ltm_core.pose_estimation.skyline.picture_pose_config import Criteria
from ltm_core.pose_estimation.skyline.pose_hypothesis import Hypothesis, judge, mean_of_both, merged_with_others
from ltm_core.pose_estimation.skyline.pose_prior import UNKNOWN_DEG, PosePrior, turned
from ltm_core.pose_estimation.skyline.pose_refinement import RefinedPose, SkylineFit


@pytest.fixture(autouse=True)
def criteria(monkeypatch: pytest.MonkeyPatch) -> None:
    limits = {"alternative_deg": 2.5, "same_deg": 0.1, "most_sigma_deg": 0.6, "close_azimuth_sigma_deg": 0.4}
    for name, value in (limits | {"agreement": 2.0}).items():
        monkeypatch.setattr(Criteria, name, value)


def hypothesis(azimuth_deg: float, cost: float, variance: float = 1.0) -> Hypothesis:
    """Of a level camera, its angles sure to 0.1, 0.05 and 0.2 degrees, on a skyline that fits."""
    pose = Pose.from_angles((10.0, 20.0, 300.0), azimuth_deg, 0.0)
    covariance = np.zeros((7, 7))
    covariance[:6, :6] = pose_covariance(pose, 0.0, 0.0, 0.1, 0.05, 0.2)
    camera = Camera.from_fov(640, 360, 50.0)
    return Hypothesis(
        RefinedPose(pose, camera, covariance, cost, SkylineFit(support=0.95, variance=variance)), cost, 1.0
    )


def moved(by_azimuth_deg: float, sigmas_deg: tuple[float, float, float]) -> Hypothesis:
    """`hypothesis(60)` so far to the right and so sure, its place within (2, 3, 4) metres."""
    one = hypothesis(60.0 + by_azimuth_deg, -100.0)
    covariance = np.diag([4.0, 9.0, 16.0, 0.0, 0.0, 0.0, 0.0])
    covariance[3:6, 3:6] = pose_covariance(one.refined.pose, 0.0, 0.0, *sigmas_deg)[3:, 3:]
    return replace(one, refined=replace(one.refined, covariance=covariance))


def word_of(
    sigmas_deg: tuple[float, float, float], seen: SkylineFit, plants: float = 0.3, gap_by_ridges: float | None = None
) -> str:
    """The verdict on a pose by a skyline, so sure and so seen, which nothing else is like."""
    best = moved(0.0, sigmas_deg).refined
    found = [Hypothesis(replace(best, skyline=seen), best.cost, 1.0)]
    return judge(found, False, PosePrior(best.pose, 1.5, 0.5, 0.5), plants, gap_by_ridges).word


def azimuth_sigma_deg(best: Hypothesis) -> float:
    return math.degrees(math.sqrt(best.refined.covariance[5, 5]))


@pytest.mark.parametrize("variance", [0.5, 1.0, 2.0])
def test_poses_that_cost_the_same_are_one_that_is_unsure(variance: float) -> None:
    others = [hypothesis(61.2, -100.0), hypothesis(60.6, -98.0), hypothesis(70.0, -99.9)]
    best, *rest = merged_with_others([hypothesis(60.0, -100.0, variance), *others])
    weight = math.exp(-2.0 / (2.0 * variance))  # the one 10 degrees off is an alternative
    mean = (1.2 + weight * 0.6) / (2 + weight)
    spread = (mean**2 + (1.2 - mean) ** 2 + weight * (0.6 - mean) ** 2) / (2 + weight)
    assert best.refined.pose.angles_deg[0] == pytest.approx(60.0 + mean, abs=1e-6)
    assert azimuth_sigma_deg(best) == pytest.approx(math.sqrt(0.1**2 + spread), rel=1e-4)
    assert rest == others


@pytest.mark.parametrize(
    ("second", "plants", "word"),
    [
        (60.7, 0.9, "accepted"),
        (60.8, 0.9, "ambiguous"),  # half of 0.8 degrees besides 0.1 is 0.41
        (60.8, 0.8, "accepted"),
        (61.2, 0.0, "ambiguous"),  # but 0.61 is too much whatever is seen
    ],
)
@pytest.mark.parametrize("stated_deg", [1.5, UNKNOWN_DEG])
def test_an_open_azimuth_is_not_accepted(second: float, plants: float, word: str, stated_deg: float) -> None:
    found = merged_with_others([hypothesis(60.0, -100.0), hypothesis(second, -100.0)])
    prior = PosePrior(found[0].refined.pose, stated_deg, 0.5, 0.5)
    assert judge(found, False, prior, plants).word == word


@pytest.mark.parametrize(
    ("gap", "variance", "word"),
    [
        (3.9, 1.0, "ambiguous"),
        (4.1, 1.0, "accepted"),
        (2.1, 0.5, "accepted"),  # small misfits tell poses apart by more
        (1.9, 0.5, "ambiguous"),
        (4.1, 3.0, "accepted"),  # large ones have made the pose unsure already
    ],
)
def test_an_alternative_must_cost_more_than_misfits_explain(gap: float, variance: float, word: str) -> None:
    found = [hypothesis(60.0, -100.0, variance), hypothesis(75.0, gap - 100.0)]
    prior = PosePrior(found[0].refined.pose, 6.0, 0.5, 0.5)
    assert judge(found, False, prior, 0.3).word == word


@pytest.mark.parametrize(("variance", "word"), [(1.0, "accepted"), (1.5, "ambiguous")])
def test_ridges_do_not_speak_for_terrain_in_the_sky(variance: float, word: str) -> None:
    found = [hypothesis(60.0, -100.0, variance)]
    prior = PosePrior(found[0].refined.pose, 1.5, 0.5, 0.5)
    assert judge(found, True, prior, 0.3).word == word


@pytest.mark.parametrize(("away_deg", "word"), [(20.0, "accepted"), (22.0, "contradicts_prior")])
def test_a_pose_at_the_edge_of_the_search_is_not_taken(away_deg: float, word: str) -> None:
    """A compass good to 6 degrees is searched to 24."""
    found = [hypothesis(60.0, -100.0)]
    prior = PosePrior(turned(found[0].refined.pose, np.radians([0.0, 0.0, away_deg])), 6.0, 0.5, 0.5)
    assert judge(found, False, prior, 0.3).word == word


def test_of_skyline_and_ridges_each_counts_half_of_what_it_knows() -> None:
    skyline, ridges = moved(0.0, (0.6, 0.05, 0.2)), moved(0.5, (0.3, 0.05, 0.2))
    both = mean_of_both(skyline, ridges)
    assert both is not None
    # Of 1 / 0.36 and 1 / 0.09 halves: (0 + 4 * 0.5) / 5 degrees to the right.
    assert both.refined.pose.angles_deg[0] == pytest.approx(60.4, abs=1e-3)
    assert azimuth_sigma_deg(both) == pytest.approx(math.sqrt(2 / (1 / 0.36 + 1 / 0.09)), rel=1e-3)
    np.testing.assert_allclose(np.diag(both.refined.covariance)[:3], (4.0, 9.0, 16.0), rtol=1e-6)
    assert both.refined.covariance[6, 6] == 0.0
    assert both.refined.camera == skyline.refined.camera


@pytest.mark.parametrize(("apart_deg", "agree"), [(1.8, True), (2.0, False)])
def test_skyline_and_ridges_that_contradict_each_other_have_no_mean(apart_deg: float, agree: bool) -> None:
    """Their difference has a sigma of 0.67 degrees: 7.8 is 2.79 of it, squared, 1.87 degrees."""
    both = mean_of_both(moved(0.0, (0.6, 0.05, 0.2)), moved(apart_deg, (0.3, 0.05, 0.2)))
    assert (both is not None) == agree


@pytest.mark.parametrize(("gap_by_ridges", "word"), [(None, "ambiguous"), (0.5, "ambiguous"), (1.5, "accepted")])
def test_what_ridges_hold_against_an_alternative_counts(gap_by_ridges: float | None, word: str) -> None:
    found = [hypothesis(60.0, -100.0), hypothesis(75.0, -97.0)]
    prior = PosePrior(found[0].refined.pose, 6.0, 0.5, 0.5)
    verdict = judge(found, False, prior, 0.3, gap_by_ridges)
    assert verdict.word == word
    assert verdict.gap == pytest.approx(3.0 + (gap_by_ridges or 0.0))


SEEN = {"support": 0.95, "variance": 1.0, "open": 0.0, "turn": 0.4, "ridges": None}


@pytest.mark.parametrize(
    ("change", "word"),
    [
        # A sharp pose needs less of the skyline, but where that may be another's.
        ({"support": 0.6, "turn": 0.2}, "accepted"),
        ({"support": 0.6}, "ambiguous"),
        ({"support": 0.7}, "accepted"),
        ({"support": 0.45, "turn": 0.2}, "ambiguous"),
        ({"support": 0.6, "turn": 0.2, "open": 0.5}, "ambiguous"),
        # Large misfits are another skyline's where no pose is sharp.
        ({"variance": 2.4}, "ambiguous"),
        ({"variance": 2.1}, "accepted"),
        ({"variance": 2.4, "turn": 0.2}, "accepted"),
        ({"variance": 2.4, "turn": 0.2, "open": 0.5}, "ambiguous"),
        # Where ridges agree, half of the skyline will do.
        ({"support": 0.6, "ridges": 0.0}, "accepted"),
        ({"support": 0.6, "ridges": 0.0, "open": 0.5}, "accepted"),
        ({"support": 0.45, "ridges": 0.0}, "ambiguous"),
    ],
)
def test_how_much_of_the_skyline_must_fit(change: dict[str, Any], word: str) -> None:
    v = SEEN | change
    seen = SkylineFit(support=v["support"], variance=v["variance"], open=v["open"])
    assert word_of((0.1, 0.05, v["turn"]), seen, gap_by_ridges=v["ridges"]) == word
