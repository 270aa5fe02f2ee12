from functools import cache

import numpy as np
import pytest
from scenes.mountain_view import CAMERA, OPEN, PRIOR, TRUE, terrain, view

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.pose import pose_sigmas
from ltm_core.pose_estimation.skyline import find_pose as pose_from_picture
from ltm_core.pose_estimation.skyline.contour_scores import PictureEvidence, picture_evidence
from ltm_core.pose_estimation.skyline.find_pose import PictureSearch, find_pose
from ltm_core.pose_estimation.skyline.picture_pose_config import Criteria
from ltm_core.pose_estimation.skyline.pose_observations import PoseProblem
from ltm_core.pose_estimation.skyline.pose_prior import PosePrior, angles_between
from ltm_core.pose_estimation.skyline.pose_refinement import settled_on_ridges, skyline_fit
from ltm_core.vision.labels import Label


@cache
def clear() -> PictureEvidence:
    """Of the true pose, the DEM's own skyline in it."""
    return picture_evidence(*view(TRUE), CAMERA)


@cache
def found_clear() -> PictureSearch:
    return find_pose(clear(), OPEN, PRIOR)


def search_of(picture: tuple[UInt8Array, UInt8Array], prior: PosePrior = PRIOR) -> PictureSearch:
    return find_pose(picture_evidence(*picture, CAMERA), OPEN, prior)


def off_deg(search: PictureSearch) -> np.ndarray:
    return np.degrees(np.abs(angles_between(TRUE, search.hypotheses[0].refined.pose)))


def with_range_behind(picture: tuple[UInt8Array, UInt8Array], columns: slice, height: int) -> None:
    """Hazy land so many pixels over the skyline of some columns."""
    photo, labels = picture
    for u in range(*columns.indices(labels.shape[1])):
        top = int(np.argmax(labels[:, u] != Label.SKY))
        rows = slice(max(0, top - height - (u // 40) % 5), top)
        labels[rows, u] = Label.BARE
        photo[rows, u] = (165, 178, 192)


def test_a_skyline_that_is_the_dem_s_own_is_laid_on_its_horizon() -> None:
    search = found_clear()
    assert search.horizon.open.mean() > 0.5
    assert search.verdict.word == "accepted", search.verdict.reason
    assert off_deg(search).max() < 0.1
    fit = search.hypotheses[0].refined.skyline
    assert fit.open > 0.8
    assert fit.support == pytest.approx(1.0, abs=0.05)


def test_a_range_behind_half_of_it_is_no_misfit() -> None:
    picture = view(TRUE)
    with_range_behind(picture, slice(0, 260), 14)
    search = search_of(picture)
    assert search.verdict.word == "accepted", search.verdict.reason
    assert off_deg(search).max() < 0.1
    assert search.hypotheses[0].refined.skyline.support > 0.9


def test_where_nothing_lies_beyond_it_is_misfit() -> None:
    picture = view(TRUE)
    with_range_behind(picture, slice(0, 260), 14)
    evidence = picture_evidence(*picture, CAMERA)
    horizon = terrain().horizon_for(evidence.camera, PRIOR)
    fit = skyline_fit(TRUE, evidence.camera, PoseProblem(evidence, horizon, PRIOR))
    assert fit.open == 0.0
    assert fit.support < 0.6


def without_ridges(evidence: PictureEvidence, *given: object) -> list[object]:
    return []


def test_what_ridges_do_not_say_too_is_taken_only_where_it_stands_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pose_from_picture, "search_ridges", without_ridges)
    found = find_pose(clear(), OPEN, PRIOR)
    assert found.verdict.word == "accepted"
    monkeypatch.setattr(Criteria, "open_gap", found.verdict.gap + 1.0)
    doubted = find_pose(clear(), OPEN, PRIOR)
    assert (doubted.verdict.word, "ridges" in doubted.verdict.reason) == ("ambiguous", True)


def test_a_skyline_of_another_shape_is_not_taken_for_the_horizon() -> None:
    picture = view(TRUE)
    photo, labels = picture
    for u, lift in enumerate(np.rint(4 * np.sin(np.arange(labels.shape[1]) / 9.0)).astype(int)):
        top = int(np.argmax(labels[:, u] != Label.SKY))
        rows = slice(min(top, top - lift), max(top, top - lift))
        labels[rows, u], photo[rows, u] = (Label.BARE, (90, 100, 80)) if lift > 0 else (Label.SKY, (190, 210, 235))
    search = search_of(picture)
    assert search.hypotheses[0].refined.skyline.variance > Criteria.most_variance
    assert search.verdict.word == "ambiguous"


@cache
def among_shrubs() -> PictureEvidence:
    """The same, by its labels with shrubs on all of its land."""
    photo, labels = view(TRUE)
    labels[labels != Label.SKY] = Label.SHRUB
    return picture_evidence(photo, labels, CAMERA)


def test_among_plants_an_open_pose_is_as_sure_as_its_ridges() -> None:
    evidence = among_shrubs()
    found = find_pose(evidence, OPEN, PRIOR)
    assert found.verdict.word == "accepted", found.verdict.reason
    best = found.hypotheses[0].refined
    again = settled_on_ridges(best, PoseProblem(evidence, found.horizon, PRIOR))
    away = np.abs(np.degrees(angles_between(best.pose, again.pose)))
    assert (away < 0.5 * np.array(found.verdict.sigma_deg)).all()
    assert found.verdict.sigma_deg == pytest.approx(
        tuple(pose_sigmas(again.pose, again.covariance[:6, :6])[3:]), rel=0.1
    )
