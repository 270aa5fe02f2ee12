from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ltm_core.base.types import Float64Array
from ltm_core.locating.turn_evidence import TURNS, TurnEvidence
from ltm_core.locating.wrong_camera import NONE_TURNED, FireMemory, judged

DEG = math.radians(1.0)
SIGMA = 0.06 * DEG


def peak(turn_deg: float, sigma: float = 0.1 * DEG) -> Float64Array:
    """Ratios, in logarithms, of marks whose density is normal around a turn."""
    bell = -0.5 * ((TURNS - turn_deg * DEG) / sigma) ** 2
    return np.asarray(np.logaddexp(bell + 0.5 * (turn_deg * DEG / sigma) ** 2, -12.0), np.float64)


def fire(**ratios: Float64Array) -> TurnEvidence:
    return TurnEvidence(ratios, dict.fromkeys(ratios, SIGMA), {})


def alike(*turns_deg: float) -> TurnEvidence:
    """A fire that tells only that some camera is turned: `a` by the first angle, or `b` by the second one, ..."""
    return fire(**{name: np.logaddexp(20.0 - 0.5 * ((TURNS - turn * DEG) / (0.1 * DEG)) ** 2, -5.0)
                   for name, turn in zip("abc", turns_deg, strict=True)})  # fmt: skip


def test_fires_tell_together_what_one_does_not() -> None:
    first, second = alike(2.0, -1.9, 2.2), alike(2.0, 0.8, -3.4)
    one = judged([first], 0.9)
    assert one.wrong is None
    assert sum(one.suspicion.values()) == pytest.approx(1.0, abs=1e-3)
    two = judged([first, second], 0.9)
    assert two.wrong == two.suspect == "a"
    assert math.degrees(two.turn) == pytest.approx(2.0, abs=0.02)
    assert math.degrees(two.sigma) == pytest.approx(0.1 / math.sqrt(2), rel=0.1)
    assert two.fires == 2


def test_of_two_cameras_one_fire_names_none() -> None:
    marks = fire(a=peak(2.0), b=np.full(len(TURNS), -12.0))
    once, twice = judged([marks], 0.75), judged([marks, marks], 0.75)
    assert once.suspicion["a"] > 0.99
    assert (once.suspect, once.wrong) == ("a", None)
    assert (twice.wrong, twice.by) == ("a", ("marks",))
    both = judged([marks, marks], 0.75, lost={"a"})
    assert (both.wrong, both.by) == ("a", ("marks", "pictures"))
    assert judged([marks], 0.75, lost={"a"}).wrong == "a"


def test_fires_of_the_morning_do_not_protect_a_camera_that_slipped_at_noon() -> None:
    hour = 3_600_000_000_000
    noon = np.logaddexp(16.0 - 0.5 * ((TURNS - 2 * DEG) / (0.1 * DEG)) ** 2, -4.0)
    fires = [fire(a=peak(0.0), b=peak(0.0))] * 2 + [fire(a=noon, b=peak(0.0))]
    assert judged(fires, 0.9, stamps=[0, hour, 5 * hour]).wrong == "a"
    assert judged(fires, 0.9).wrong is None


def test_cameras_that_always_agree_are_not_suspect() -> None:
    flat = {name: peak(0.0) for name in "abc"}
    assert judged([fire(**flat)] * 5, 0.9).suspicion == pytest.approx(dict.fromkeys("abc", 0.0), abs=0.05)
    assert judged([], 0.9) == NONE_TURNED


def test_an_error_that_the_pose_allows_is_not_a_turn() -> None:
    # Two sigmas off, at ten fires: against poses without any error this would be 18 in the logarithm.
    off = {"a": peak(0.12, sigma=0.2 * DEG), "b": peak(0.0), "c": peak(0.0)}
    assert judged([fire(**off)] * 10, 0.9).wrong is None
    assert judged([fire(a=peak(0.6, sigma=0.2 * DEG), b=peak(0.0), c=peak(0.0))] * 10, 0.9).wrong == "a"


def named(memory: FireMemory) -> str:
    return memory.verdict.wrong or ""


def test_the_memory_of_fires_forgets_and_is_bounded() -> None:
    memory = FireMemory(0.9, memory_ns=100, most=2)
    first, second = alike(2.0, -1.9, 2.2), alike(2.0, 0.8, -3.4)
    memory.note(1, 0, first)
    memory.note(1, 10, first)  # the same fire again is no more evidence
    assert memory.verdict.fires == 1
    memory.note(2, 20, second)
    assert named(memory) == "a"
    memory.note(2, 30, fire(a=peak(0.0), b=peak(0.0)))  # fewer cameras: what three have said stays
    assert named(memory) == "a"
    memory.note(3, 115, fire(d=peak(0.0)))  # the first is forgotten
    assert named(memory) == ""
    for number in range(4, 9):
        memory.note(number, 120, first)
    assert memory.verdict.fires == 2
    memory.expire(221)  # though no other fire has come
    assert memory.verdict == NONE_TURNED


def test_what_is_marked_again_and_again_at_one_place_counts_once() -> None:
    """A chimney, say: where the terrain model errs there, it speaks against the same camera each time."""
    memory = FireMemory(0.9)
    unsure = alike(2.0, -1.9, 2.2)

    def marked(*degrees: float) -> TurnEvidence:
        return replace(unsure, azimuths={name: at * DEG for name, at in zip("abc", degrees, strict=True)})

    for number in range(10):
        memory.note(number, number, marked(179.9 if number % 2 else -179.9, 40.0 + 0.05 * number, 70.0))
    assert memory.verdict.fires == 1
    memory.note(10, 10, marked(180.0, 42.0, 70.0))
    assert memory.verdict.fires == 2
    memory.note(11, 11, replace(unsure, azimuths={"a": math.pi}))  # one camera's direction is no place
    assert memory.verdict.fires == 3
