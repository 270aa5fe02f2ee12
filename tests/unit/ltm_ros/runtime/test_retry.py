"""Pauses between attempts that fail."""

from __future__ import annotations

import random

from ltm_ros.runtime.retry import Backoff


def test_the_pause_doubles_up_to_its_limit_and_begins_anew_after_a_success() -> None:
    backoff = Backoff(1.0, 60.0)
    assert [backoff.failed() for _ in range(8)] == [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 60.0, 60.0]
    for _ in range(2000):
        backoff.failed()
    assert backoff.pause_s == 60.0
    backoff.succeeded()
    assert backoff.failed() == 1.0


def test_jitter_shortens_pauses_by_up_to_half() -> None:
    backoff = Backoff(1.0, 60.0, random.Random(1))
    pauses = [backoff.failed() for _ in range(12)]
    assert all(max(1.0, 2.0**i / 2) <= pause <= 2.0**i for i, pause in enumerate(pauses[:6]))
    assert all(30.0 <= pause <= 60.0 for pause in pauses[6:])
    assert len(set(pauses[6:])) == 6


def test_it_is_due_once_the_pause_has_passed() -> None:
    backoff = Backoff(2.0, 15.0)
    assert backoff.due
    for pause in (2.0, 4.0):
        assert backoff.failed() == pause
        backoff.passed(pause - 0.5)
        assert not backoff.due
        backoff.passed(0.5)
        assert backoff.due
    backoff.failed()
    backoff.succeeded()
    assert backoff.due
