"""What was seen of a camera before it slipped says nothing against a slip; what was seen since does."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from ltm_core.base.types import Float64Array
from ltm_core.locating.picture_memory import remembered
from ltm_core.locating.slip_history import misled_share, picture_likelihood, turned_ratios
from ltm_core.locating.turn_evidence import STEP, TURNS, TurnEvidence
from ltm_core.locating.turn_watch import TurnWatch, judged
from ltm_core.pose_estimation.mount.skyline_turns import SKYLINE_TURNS, SkylineTurns

DEG = math.radians(1.0)
SECOND, HOUR = 1_000_000_000, 3_600_000_000_000
MIDDLE = len(TURNS) // 2


def picture(turn_deg: float, second: float = 0, azimuth_deg: float = 0.0) -> SkylineTurns:
    logs = -0.5 * ((SKYLINE_TURNS - turn_deg * DEG) / (0.2 * DEG)) ** 2
    return SkylineTurns(round(second * SECOND), azimuth_deg * DEG, 60 * DEG, np.maximum(logs, -40.0))


def marks(turn_deg: float, height: float = 8.0) -> Float64Array:
    peak = height - 0.5 * ((TURNS - turn_deg * DEG) / (0.1 * DEG)) ** 2
    return np.asarray(np.logaddexp(peak, -4.0), np.float64)


def unsure(*turns_deg: float) -> TurnEvidence:
    """A fire of three cameras of which one is turned, nobody knows which."""
    ratios = {name: marks(turn) for name, turn in zip("abc", turns_deg, strict=True)}
    return TurnEvidence(ratios, dict.fromkeys(ratios, 0.06 * DEG), {})


def at(logs: Float64Array, turn_deg: float) -> float:
    return float(logs[int(np.argmin(np.abs(TURNS - turn_deg * DEG)))])


def test_a_picture_says_only_so_much() -> None:
    """It may be misled, in one direction of ten; of turns beyond what was asked it says nothing."""
    likely = picture_likelihood(picture(2.0))
    assert TURNS[int(likely.argmax())] == pytest.approx(2.0 * DEG, abs=STEP)
    assert likely.min() == pytest.approx(0.01, abs=0.001)
    assert at(likely, 12.0) == pytest.approx(1.0, abs=0.01)
    assert 10.0 < likely.max() < 50.0
    flat = replace(picture(0.0), logs=np.zeros(len(SKYLINE_TURNS)))
    assert picture_likelihood(flat) == pytest.approx(np.ones(len(TURNS)))
    always = turned_ratios([], [picture(2.0)])[0]
    expected = np.log((0.9 * likely + 0.1) / (0.9 * likely[MIDDLE] + 0.1))
    np.testing.assert_allclose(always, expected, atol=1e-9)
    assert at(always, 12.0) < math.log(10.0)


def test_a_direction_is_believed_by_what_it_has_shown_before() -> None:
    """Bayes' rule: of pictures that fitted no turn e^a times better than any other angle."""
    shares = misled_share(np.array([0.0, math.log(20.0), math.log(0.01)]))
    assert shares == pytest.approx([0.1, 0.1 / (0.1 + 0.9 * 20), 0.1 / (0.1 + 0.9 * 0.01)])


def fixed(before_deg: float | None, after_deg: float, count: int = 4) -> list[SkylineTurns]:
    """Of a fixed camera, every ten seconds: before a slip, if at all, and after it."""
    before = [] if before_deg is None else [picture(before_deg, 10 * k) for k in range(count)]
    return [*before, *(picture(after_deg, 10 * k) for k in range(count, 3 * count))]


def test_a_direction_that_showed_no_turn_is_believed_when_it_shows_one() -> None:
    """What both hypotheses share, that the direction may mislead at all times, cancels out but for its probability."""
    here = picture_likelihood(picture(2.0))
    straight = picture_likelihood(picture(0.0))[MIDDLE]
    both = turned_ratios([], fixed(0.0, 2.0))[1]
    most = (0.9 * straight * at(here, 2.0) + 0.1) / (0.9 * straight * here[MIDDLE] + 0.1)
    # The same, but for what was seen before: that was another direction.
    elsewhere = [picture(0.0, 10 * k, 90.0) for k in range(4)]
    unknown = turned_ratios([], [*elsewhere, *fixed(None, 2.0)])[1]
    # As if it were known when it slipped, but for the chance that it did in ten seconds of a day.
    assert math.log(most) - 5.0 < at(both, 2.0) < math.log(most)
    assert at(both, 2.0) > at(unknown, 2.0) + 1.0
    right = {name: fixed(0.0, 0.0) for name in "bc"}
    hour = [replace(seen, stamp_ns=seen.stamp_ns + (HOUR if k >= 4 else 0)) for k, seen in enumerate(fixed(0.0, 2.0))]
    assert judged([], 0.75, pictures={"a": hour, **right}).wrong == "a"
    assert judged([], 0.75, pictures={name: fixed(0.0, 0.0) for name in "abc"}).wrong is None


def test_a_direction_that_misled_before_is_not_believed() -> None:
    """It showed a turn of three degrees while the others showed none: what it shows now is no evidence."""
    before = [picture(3.0, 10 * k) for k in range(4)]
    ever = turned_ratios([], [*before, *(picture(0.0, 5 + 10 * k, 90.0) for k in range(4)), picture(2.0, 50)])[1]
    believed = turned_ratios([], [*(picture(0.0, 10 * k) for k in range(4)), picture(2.0, 50)])[1]
    assert at(ever, 2.0) < 0.0 < at(believed, 2.0)


def test_many_pictures_of_one_direction_say_no_more_of_it_than_one() -> None:
    one, many = [picture(0.0, 90)], [picture(0.0, 90 - k / 1000) for k in range(9)]
    later = [picture(2.0, 100)]
    alone, all_of_them = (at(turned_ratios([], [*reversed(before), *later])[1], 2.0) for before in (one, many))
    assert all_of_them == pytest.approx(alone, abs=0.1)


def test_one_picture_that_passes_names_nobody() -> None:
    """A cloud lay on the ridge: the same direction shows no turn again."""
    passing = [picture(2.0 if k == 4 else 0.0, 10 * k) for k in range(8)]
    assert judged([], 0.75, pictures={"a": passing, "b": fixed(0.0, 0.0), "c": fixed(0.0, 0.0)}).wrong is None


def test_of_older_pictures_fewer_are_remembered_but_some_of_each_direction() -> None:
    """So that a camera which is named stays named, however many pictures it has shown since it slipped."""
    kept: list[SkylineTurns] = []
    for number in range(400):
        kept = remembered([*kept, picture(0.0, 10 * number, 90.0 * (number % 2))], 12)
    ages = [(3990 * SECOND - seen.stamp_ns) / SECOND for seen in kept]
    assert len(kept) <= 24
    assert ages == sorted(ages, reverse=True)
    assert ages[-12:] == [10.0 * k for k in reversed(range(12))]
    for azimuth in (0.0, 90.0 * DEG):
        older = [age for age, seen in zip(ages, kept, strict=True) if seen.azimuth == azimuth and age >= 120.0]
        assert len(older) > 3
        assert older[0] > 3900.0
        assert all(one >= 2 * other for one, other in pairwise(older))


def test_a_fixed_camera_stays_named() -> None:
    watch = TurnWatch(0.75)
    for number in range(60):
        for name in "abc":
            watch.look(name, picture(2.0 if name == "a" and number >= 10 else 0.0, 10 * number))
        assert number >= 10 or watch.verdict.wrong is None
        assert number < 40 or watch.verdict.wrong == "a"


def test_marks_alone_are_as_they_were() -> None:
    one = marks(2.0)
    always, ever = turned_ratios([(5, one)], [])
    np.testing.assert_allclose(always, one)
    np.testing.assert_allclose(ever, one)
    always, ever = turned_ratios([(5, one), (5, one)], [])
    np.testing.assert_allclose(ever, 2 * one)


def test_pictures_of_one_direction_count_once() -> None:
    """The terrain model has the same errors in each; another direction's says more."""
    one = turned_ratios([], [picture(2.0)])[0]
    again = turned_ratios([], [picture(2.0)] * 4)[0]
    beside = turned_ratios([], [picture(2.0), picture(2.0, azimuth_deg=90.0)])[0]
    np.testing.assert_allclose(again, one, atol=1e-9)
    np.testing.assert_allclose(beside, 2 * one, atol=1e-9)


@pytest.mark.parametrize(("age", "least"), [(30.0, -6.0), (8 * 3600.0, -1.0)])
def test_a_picture_from_before_the_turn_protects_the_less_the_older_it_is(age: float, least: float) -> None:
    alone = at(turned_ratios([(0, marks(2.0))], [])[1], 2.0)
    before = at(turned_ratios([(round(age * SECOND), marks(2.0))], [picture(0.0)])[1], 2.0)
    since = at(turned_ratios([(round(age * SECOND), marks(2.0))], [picture(0.0, age)])[1], 2.0)
    assert least < before - alone < 0
    # The newest one was taken with the marks: nothing can have happened in between.
    assert since - alone == pytest.approx(at(turned_ratios([], [picture(0.0)])[0], 2.0), abs=0.1)


def test_fires_of_the_morning_do_not_protect_a_camera_that_slipped_at_noon() -> None:
    right, turned = marks(0.0) - 8.0, marks(2.0, height=16.0)
    ratios = turned_ratios([(0, right), (HOUR, right), (5 * HOUR, turned)], [])
    assert at(ratios[0], 2.0) == pytest.approx(16 - 2 * 12, abs=0.1)
    assert at(ratios[1], 2.0) > 14


def test_pictures_tell_which_camera_it_is() -> None:
    fire = unsure(2.0, -1.9, 2.2)
    assert judged([fire], 0.75).wrong is None
    seen = {"a": [picture(2.0)], "b": [picture(0.0)], "c": [picture(0.0)]}
    verdict = judged([fire], 0.75, pictures=seen)
    assert (verdict.wrong, verdict.fires, verdict.pictures) == ("a", 1, 1)
    assert math.degrees(verdict.turn) == pytest.approx(2.0, abs=0.05)
    assert judged([fire], 0.75, pictures={"b": [picture(0.0)], "c": [picture(0.0)]}).wrong == "a"
    right = {name: [picture(0.0)] for name in "abc"}
    calm = TurnEvidence({name: marks(0.0) for name in "abc"}, dict.fromkeys("abc", 0.06 * DEG), {})
    assert judged([calm], 0.75, pictures=right).wrong is None


def test_of_two_cameras_that_mark_one_fire_pictures_name_one() -> None:
    ratios = {"a": marks(2.0), "b": np.full(len(TURNS), -4.0)}
    fire = TurnEvidence(ratios, dict.fromkeys(ratios, 0.06 * DEG), {})
    assert judged([fire], 0.75).wrong is None
    assert judged([fire], 0.75, pictures={"a": [replace(picture(0.0), logs=np.zeros(101))]}).wrong is None
    told = [picture(2.0, azimuth_deg=azimuth) for azimuth in (0.0, 90.0)]
    assert judged([fire], 0.75, pictures={"a": told}).wrong == "a"


def test_the_watch_says_what_has_named_a_camera() -> None:
    watch = TurnWatch(0.75)
    for number in range(6):
        watch.look("a", picture(2.0, number, 60.0 * (number % 3)))
    assert (watch.verdict.wrong, watch.verdict.by) == ("a", ("pictures",))
    watch.note(1, 6 * SECOND, unsure(2.0, -5.0, 5.0))
    watch.note(2, 7 * SECOND, unsure(2.0, 4.0, -4.0))
    assert (watch.verdict.wrong, watch.verdict.by) == ("a", ("marks", "pictures"))
    watch.forget("a")
    assert watch.verdict.wrong is None


def test_neither_alone_but_both_together() -> None:
    watch = TurnWatch(0.75)
    watch.note(1, 0, unsure(2.0, -1.9, 2.2))
    vague = -0.5 * ((SKYLINE_TURNS - 2 * DEG) / (1.5 * DEG)) ** 2
    watch.look("a", replace(picture(2.0), logs=vague))
    assert watch.verdict.wrong is None
    for name in "bc":
        watch.look(name, picture(0.0))
    assert (watch.verdict.wrong, watch.verdict.by) == ("a", ("marks", "pictures"))


def test_pictures_are_forgotten_and_bounded() -> None:
    watch = TurnWatch(0.75, memory_ns=100 * SECOND, most_pictures=3)
    for number in range(9):
        watch.look("a", picture(2.0, number, 120.0 * number))
    assert watch.verdict.pictures == 6
    watch.expire(107 * SECOND)
    assert watch.verdict.pictures == 2
    watch.expire(300 * SECOND)
    assert watch.verdict.suspicion == {}


def test_a_camera_that_its_node_says_is_lost_is_named() -> None:
    """By six pictures, say, of which the newest alone would leave it open."""
    vague = replace(picture(1.5), logs=-0.5 * ((SKYLINE_TURNS - 1.5 * DEG) / (2 * DEG)) ** 2)
    watch = TurnWatch(0.75)
    for name in "abc":
        watch.look(name, vague)
    assert watch.verdict.wrong is None
    watch.lost.add("b")
    assert (watch.verdict.wrong, watch.verdict.by) == ("b", ("pictures",))


def test_the_middle_is_no_turn() -> None:
    assert TURNS[MIDDLE] == SKYLINE_TURNS[len(SKYLINE_TURNS) // 2] == 0.0
