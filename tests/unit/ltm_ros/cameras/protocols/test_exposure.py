import math
import random

import numpy as np
import pytest

from ltm_ros.cameras.protocols.exposure import ExposureClock
from ltm_ros.cameras.protocols.picture import CameraTime, Timing

WALL = 1_790_000_000.0
"""Wall less monotonic seconds."""


def errors_of_snapshots(
    ahead: float, tells: str, count: int = 200, zone_s: float = 0.0
) -> tuple[list[float], list[float]]:
    """Errors and told uncertainties of pictures that were taken at some moment of the last half second before they were
    asked for, by a camera that is `ahead` and tells its time in whole seconds."""
    chance, clock = random.Random(11), ExposureClock()
    errors, told = [], []
    for i in range(count):
        asked = 100.0 + 10 * i + chance.uniform(0, 2)
        taken = asked - chance.uniform(0, 0.5)
        arrived = asked + chance.uniform(0.01, 0.2)
        answered_at = chance.uniform(asked, arrived)
        answered = CameraTime(math.floor(WALL + answered_at + ahead), 1.0, "date")
        stated = CameraTime(math.floor(WALL + taken + ahead) + zone_s, 1.0, tells) if tells else None
        exposure = clock.estimate(Timing(arrived, asked, 1.0, stated, answered), WALL)
        errors.append(exposure.at - taken)
        told.append(exposure.uncertainty)
    assert clock.offset(WALL) == pytest.approx(ahead, abs=0.1)
    return errors, told


@pytest.mark.parametrize("ahead", [0.0, 37.0, -3600.0, -1.7e9])
@pytest.mark.parametrize("tells", ["last-modified", "exif", ""])
def test_a_snapshots_time_is_within_six_tenths_whatever_the_cameras_clock_says(ahead: float, tells: str) -> None:
    errors, told = errors_of_snapshots(ahead, tells)
    assert np.quantile(np.abs(errors), 0.95) < 0.6
    assert (np.abs(errors) <= told).mean() >= 0.95
    assert max(told) < 1.2


def test_a_clock_that_is_set_is_learnt_anew_at_once() -> None:
    clock = ExposureClock()
    for i in range(20):
        ahead = 37.0 if i < 10 else -5.0
        at = 50.0 + 10.3 * i
        stated = CameraTime(math.floor(WALL + at + ahead), 1.0, "last-modified")
        exposure = clock.estimate(Timing(at + 0.05, at, 1.0, stated, stated), WALL)
        assert abs(exposure.at - at) <= min(exposure.uncertainty, 0.6), i
    assert clock.resets
    assert clock.offset(WALL) == pytest.approx(-5.0, abs=0.2)


def stream(
    clock: ExposureClock, begin: float, count: int, ahead: float, reports_from: int = 8, seed: int = 2
) -> list[tuple[float, float]]:
    """Errors and told uncertainties of 10 pictures a second that take 20 to 200 ms."""
    chance, found = random.Random(seed), []
    for i in range(count):
        taken = begin + 0.1 * i
        arrived = taken + 0.02 + 0.18 * chance.random() ** 3
        report = CameraTime(WALL + taken + ahead, 0.0, "sender-report") if i >= reports_from else None
        timing = Timing(arrived, None, 0.5, report, stream=taken - begin, least_delay=0.02)
        exposure = clock.estimate(timing, WALL)
        found.append((exposure.at - taken, exposure.uncertainty))
    return found


@pytest.mark.parametrize("ahead", [0.0, 37.0, -86400.0])
def test_a_streams_times_are_within_fifty_milliseconds(ahead: float) -> None:
    clock = ExposureClock()
    clock.connected()
    found = np.abs(stream(clock, 100.0, 300, ahead))
    assert np.quantile(found[20:, 0], 0.95) < 0.05
    assert (found[:, 0] <= found[:, 1]).mean() >= 0.95
    assert clock.offset(WALL) == pytest.approx(ahead, abs=0.05)


def test_a_trusted_clock_is_taken_at_its_word() -> None:
    taken = CameraTime(WALL + 500.0, 0.0, "sender-report")
    exposure = ExposureClock().estimate(Timing(500.9, None, 0.5, taken, stream=3.0, trusted=True), WALL)
    assert exposure.at == pytest.approx(500.0)
    assert exposure.uncertainty == pytest.approx(0.02)


def test_no_picture_is_taken_after_it_came() -> None:
    future = CameraTime(WALL + 900.0, 0.0, "name")
    assert ExposureClock().estimate(Timing(500.0, None, 0.5, future, trusted=True), WALL).at == 500.0


def test_a_streams_clock_that_was_set_while_it_was_away_is_learnt_anew() -> None:
    clock = ExposureClock()
    clock.connected()
    stream(clock, 100.0, 100, 37.0)
    for ahead, begin in ((30.0, 150.0), (45.0, 170.0)):
        clock.connected()
        found = stream(clock, begin, 40, ahead, reports_from=0, seed=7)
        assert all(abs(error) <= told for error, told in found), ahead
        assert clock.offset(WALL) == pytest.approx(ahead, abs=0.05)
