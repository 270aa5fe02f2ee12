"""What became of the frames of a graph whose processes are killed."""

from __future__ import annotations

from ltm_lab.bench.graph_kills import Fates, Outage, ShedCounter, fates
from ltm_lab.bench.graph_site import camera_of, stamp_of_frame

S = 10**9


def stamps(seconds: list[float], camera: int) -> list[int]:
    return [stamp_of_frame(round(second * S), camera) for second in seconds]


def test_a_stamp_names_its_camera() -> None:
    (stamp,) = stamps([12.345678901], 7)
    assert camera_of(stamp) == 7
    assert abs(stamp - 12_345_678_901) < 1000


def test_each_frame_has_one_fate() -> None:
    """Killed at 20 s: camera 0 is back with its frame of 23 s, camera 1 with that of 22 s."""
    first, second = stamps([1, 14, 19, 21, 22, 23, 24], 0), stamps([1, 14, 19, 21, 22, 23], 1)
    stored = {first[0], first[5], second[0], second[1], second[4]}
    outage = Outage(20 * S, {0: first[5], 1: second[4]}, 4.0)
    # Camera 0: 14 and 24 are missing at other times, 19 was at work, 21 and 22 found nobody. Camera 1: 19, 21, and 23.
    assert fates([*first, *second], stored, [outage]) == Fates(stored=5, in_flight=2, away=3, otherwise=3)


def test_without_a_kill_nothing_is_excused() -> None:
    sent = stamps([1, 2, 3], 0)
    assert fates(sent, {sent[1]}, []) == Fates(stored=1, in_flight=0, away=0, otherwise=2)


def test_what_is_shed_adds_up_over_lives() -> None:
    north, east = "/s/north/capture", "/s/east/capture"
    counter = ShedCounter({north: {"dropped.shed": "5"}})
    counter.read({north: {"dropped.shed": "9"}, "/s/fuel_map": {"frames": "3"}})
    counter.read({north: {"dropped.shed": "2"}})  # begun anew
    counter.read({north: {"dropped.shed": "2"}, east: {"dropped.shed": "1"}})
    assert counter.total == 4 + 2 + 1
