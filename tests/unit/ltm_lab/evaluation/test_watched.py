"""Trials of watched eyes: what is shown to them, and who is named by what."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scenes.mountain_view import CAMERA, eye, terrain, view

from ltm_core.geometry.pose import Pose
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.turn_evidence import TURNS, TurnEvidence
from ltm_core.pose_estimation.mount.mount_model import PoseCorrection
from ltm_core.pose_estimation.mount.skyline_turns import SKYLINE_TURNS, SkylineTurns
from ltm_core.pose_estimation.skyline.picture_evidence import picture_evidence
from ltm_core.pose_estimation.skyline.picture_pose_config import PicturePoseConfig
from ltm_lab.evaluation.locating.smoke_sites import ranged_mountains, smoke_site
from ltm_lab.evaluation.locating.smoke_trials import PoseErrors
from ltm_lab.evaluation.locating.watched_eyes import AFTER, SIDES, Shown, WatchedEye, watched_eye
from ltm_lab.evaluation.locating.watched_trials import WatchedCase, WatchedScore, eyes_site, watched_cases
from ltm_lab.evaluation.pose.pose_trial import PreparedFrame
from ltm_lab.evaluation.truth_frames_io import TruthFrame

pytestmark = pytest.mark.kernel

DEG = math.radians(1.0)
SECOND = 1_000_000_000
STATED = PoseCorrection(np.zeros(3), None)


def said(turn_deg: float, second: int) -> SkylineTurns:
    logs = np.maximum(-0.5 * ((SKYLINE_TURNS - turn_deg * DEG) / (0.2 * DEG)) ** 2, -40.0)
    return SkylineTurns(second * SECOND, math.radians(100.0 * second), 1.0, logs)


def made_eye(name: str, position: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> WatchedEye:
    """Pictures every ten seconds in other directions, two of them before the turn; noticed by its node at the third."""
    shown = {
        (side, after): Shown(
            (said(0.0, 0), said(0.0, 10), *(said(2.0 * side, 20 + 10 * k) for k in range(after))),
            after > 3 and side != 0,
        )
        for side in SIDES
        for after in AFTER
    }
    return WatchedEye(name, np.array(position), np.zeros(6), STATED, True, shown)


def made_case(turned: str) -> WatchedCase:
    """Marks that say that some camera is turned, or that none is."""
    at = {"a": 2.0, "b": -1.9, "c": 2.2} if turned else dict.fromkeys("abc", 0.0)
    ratios = {
        name: np.logaddexp((8.0 if turned else 0.0) - 0.5 * ((TURNS - turn * DEG) / (0.1 * DEG)) ** 2, -6.0)
        for name, turn in at.items()
    }
    fire = TurnEvidence(ratios, dict.fromkeys("abc", 0.06 * DEG), {})
    return WatchedCase("s", turned, fire, {n: made_eye(n) for n in "abc"}, {n: int(n == turned) for n in "abc"})


def test_who_is_named_by_what() -> None:
    cases = [made_case("a"), replace(made_case("a"), fire=None)]
    before = WatchedScore.of(cases, 0, 0.75, 10.0)
    assert (before.marks, before.pictures, before.both) == (0.0, 0.0, 0.0)
    after = WatchedScore.of(cases, 3, 0.75, 10.0)
    assert (after.count, after.marks, after.pictures, after.both) == (2, 0.0, 1.0, 1.0)
    lost = WatchedScore.of(cases, 10, 0.75, 10.0)
    assert (lost.pictures, lost.both, lost.right_both) == (1.0, 1.0, 0.0)
    none = WatchedScore.of([made_case("")], 10, 0.75, 10.0)
    assert (none.both, none.right_marks, none.right_pictures, none.right_both) == (0.0, 0.0, 0.0, 0.0)


def test_a_right_camera_that_is_named_is_counted() -> None:
    wrong = replace(made_case("a"), turned="b")
    score = WatchedScore.of([wrong], 3, 0.75, 10.0)
    assert (score.both, score.right_both) == (0.0, 1.0)


def test_the_longer_without_pictures_the_sooner_is_one_that_then_shows_a_turn_believed() -> None:
    case = made_case("a")
    now, later = (case.pictures(0.75, 1, gap).suspicion["a"] for gap in (10.0, 3600.0))
    assert now < later


def test_three_eyes_that_see_one_fire() -> None:
    """On mountains, the eyes on summits; their poses are exact."""
    towers = smoke_site("small", ranged_mountains(3, 330, 30.0), 3.0, 5).towers
    eyes = [made_eye(f"eye{k}", tuple(tower.tolist())) for k, tower in enumerate(towers)]
    buried = made_eye("buried", (float(towers[0, 0]), float(towers[0, 1]), -50.0))
    site = eyes_site("small", ranged_mountains(3, 330, 30.0), [], 3.0, 5)
    assert site.towers.shape == (0, 3)
    model = smoke_site("small", ranged_mountains(3, 330, 30.0), 3.0, 5).model
    site = eyes_site("small", model, [*eyes, buried], 3.0, 5)
    assert len(site.towers) >= 3
    assert -50.0 not in site.towers[:, 2]
    assert (site.truth.elevation - site.model.elevation).std() == pytest.approx(3.0, rel=0.01)
    config = LocatingConfig(dem_sigma=3.0)
    (case,) = watched_cases(site, [*eyes, buried], 1, True, PoseErrors(0.06), config, 0.0, 2)
    assert case.turned in case.eyes
    assert sorted(map(abs, case.sides.values())) == [0, 0, 1]
    assert case.fire is not None
    assert case.fire.ratios.keys() == case.eyes.keys()
    assert [*watched_cases(site, [buried, *eyes[:2]], 1, True, PoseErrors(0.06), config, 0.0, 2)] == []


@pytest.mark.slow
def test_an_eye_is_shown_its_pictures_before_and_after_the_turn() -> None:
    config, frames = PicturePoseConfig(), []
    for azimuth in (63.0, 250.0):
        pose = Pose.from_angles(eye(), azimuth, 2.5, 1.2)
        photo, labels = view(pose)
        none = np.zeros(labels.shape, np.float32)
        frame = TruthFrame("mast", 0, CAMERA, pose, photo, none, none, labels, labels > 99)
        frames.append(PreparedFrame("mast", frame, picture_evidence(photo, labels, CAMERA, config), 0.0, 0.0))
    found = watched_eye("mast", frames, terrain(), PoseErrors(0.06), np.random.default_rng(1), config)
    assert found.held
    for side in SIDES:
        first, last = found.shown[side, 0], found.shown[side, 3]
        assert (first.noticed, found.shown[side, 10].noticed) == (False, side != 0)
        assert len(last.turns) == len(first.turns) + 3
        best = np.degrees([SKYLINE_TURNS[turns.logs.argmax()] for turns in last.turns])
        np.testing.assert_allclose(best[: len(first.turns)], 0.0, atol=0.15)
        np.testing.assert_allclose(best[len(first.turns) :], 2.0 * side, atol=0.15)
        assert (np.diff([turns.stamp_ns for turns in last.turns]) > 0).all()
