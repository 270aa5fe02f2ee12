from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scenes.mountain_view import CAMERA, PRIOR, TRUE, terrain, view

from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.skyline import find_pose as pose_from_picture
from ltm_core.pose_estimation.skyline.contour_scores import PictureEvidence, picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch, find_pose
from ltm_core.pose_estimation.skyline.picture_pose_config import Criteria
from ltm_core.pose_estimation.skyline.pose_hypothesis import Hypothesis
from ltm_core.pose_estimation.skyline.pose_prior import angles_between, turned


@cache
def evidence() -> PictureEvidence:
    return picture_evidence(*view(TRUE), CAMERA)


@cache
def by_skyline() -> PictureSearch:
    search = find_pose(evidence(), terrain(), PRIOR)
    assert search.verdict.word == "accepted", search.verdict.reason
    return search


LONE = {"lone_score": 1e6, "lone_sigma_deg": 1e-6}
"""As if nothing but its skyline told any pose."""


def search_with_ridges(
    monkeypatch: pytest.MonkeyPatch, apart_deg: float, share: float, **limits: float
) -> tuple[PictureSearch, int]:
    """The search, where ridges alone lie so far to the left and are as unsure by a share; how often it asked them."""
    best = by_skyline().hypotheses[0]
    for name, value in limits.items():
        monkeypatch.setattr(Criteria, name, value)
    pose = turned(best.refined.pose, np.radians([0.0, 0.0, apart_deg]))
    ridges = replace(best.refined, pose=pose, covariance=best.refined.covariance * share**2)
    asked = []

    def search_ridges(*_: object) -> list[Hypothesis]:
        asked.append(True)
        return [Hypothesis(ridges, best.cost, 9.0)]

    monkeypatch.setattr(pose_from_picture, "search_ridges", search_ridges)
    return find_pose(evidence(), terrain(), PRIOR), len(asked)


def azimuth_off_deg(search: PictureSearch, pose: Pose) -> float:
    return float(np.degrees(angles_between(pose, search.hypotheses[0].refined.pose)[0]))


def test_a_clear_view_asks_no_ridges(monkeypatch: pytest.MonkeyPatch) -> None:
    search, asked = search_with_ridges(monkeypatch, 1.0, 1.0)
    assert asked == 0
    assert search.verdict.word == "accepted"


def test_one_crest_that_ridges_are_not_on_is_not_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    search, asked = search_with_ridges(monkeypatch, 1.0, 1.0, **LONE)
    assert asked == 1
    assert search.verdict.word == "ambiguous"
    assert "single ridge" in search.verdict.reason
    assert azimuth_off_deg(search, by_skyline().hypotheses[0].refined.pose) == pytest.approx(0.0, abs=1e-9)


def test_where_ridges_agree_the_pose_is_between(monkeypatch: pytest.MonkeyPatch) -> None:
    apart = by_skyline().verdict.sigma_deg[0]
    search, _ = search_with_ridges(monkeypatch, apart, 0.5, **LONE)
    assert search.verdict.word == "accepted", search.verdict.reason
    # Ridges twice as sure count four times as much; a turn to the left lessens an azimuth.
    off = azimuth_off_deg(search, by_skyline().hypotheses[0].refined.pose)
    assert off == pytest.approx(-0.8 * apart, rel=0.05)
    assert search.verdict.sigma_deg[0] == pytest.approx(apart * np.sqrt(2 / (1 + 4)), rel=0.05)


@pytest.mark.parametrize(("apart_deg", "word"), [(0.0, "accepted"), (1.0, "ambiguous")])
def test_a_skyline_that_leaves_the_pose_open_is_enough_where_ridges_agree(
    apart_deg: float, word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    most = 0.8 * max(by_skyline().verdict.sigma_deg)
    search, asked = search_with_ridges(monkeypatch, apart_deg, 0.25, most_sigma_deg=most)
    assert asked == 1
    assert search.verdict.word == word, search.verdict.reason
