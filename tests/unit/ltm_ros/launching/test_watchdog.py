from __future__ import annotations

import json

import pytest

from ltm_core.site.sections import WatchdogConfig
from ltm_ros.launching.watchdog import GraphTraffic, HangWatch, HearingWatch, ProcessUse

LIMITS = WatchdogConfig(silent=20.0, stuck=60.0, slow=300.0)
IDLE = ProcessUse("S", 0.0)
WELL: list[tuple[float, bool, str]] = [(0.0, False, "executor: callback")]


def beat(turns: object, said: dict[str, int] | None = None, heard: dict[str, int] | None = None) -> bytes:
    told = {"activities": turns, "ready": [], "said": said or {}, "heard": heard or {}}
    return json.dumps(told).encode() + b"\n"


class Watched:
    """A process that is looked at once a second."""

    def __init__(self, slow_starts: int = 0) -> None:
        self.watch = HangWatch(LIMITS, slow_starts)

    def hang(self, seconds: int, heard: bytes = b"", use: ProcessUse = IDLE) -> tuple[int, str]:
        """After how many seconds it was taken for hung, and why; `seconds` and nothing where it was not."""
        for second in range(1, seconds + 1):
            if found := self.watch.look(1.0, heard, use):
                return second, found
        return seconds, ""


def test_a_silent_process_hangs_and_one_that_is_stopped_is_said_to_be() -> None:
    watched = Watched()
    assert watched.hang(1000, beat(WELL)) == (1000, "")
    assert watched.hang(1000) == (21, "no heartbeat for 21 s")
    watched.watch.look(1.0, beat(WELL), IDLE)
    assert watched.hang(1000, use=ProcessUse("T", 0.0))[1].endswith("it is stopped (SIGSTOP)")


@pytest.mark.parametrize("state", ["R", "D"])
def test_what_waits_for_a_core_or_a_disk_has_as_long_as_a_message(state: str) -> None:
    """A machine that is busy, or whose disk stands still for a while, is not helped by another start."""
    watched = Watched()
    watched.watch.look(1.0, beat(WELL), IDLE)
    assert watched.hang(1000, use=ProcessUse(state, 0.0)) == (
        61,
        "no heartbeat for 61 s, although it is computing or waiting for a core",
    )


def test_a_worker_that_stands_is_seen_though_the_process_lives() -> None:
    def at_work(age: float, slow: bool = False) -> bytes:
        return beat([(0.0, False, "executor: callback"), (age, slow, "depth worker: CameraInfo")])

    watch = HangWatch(LIMITS)
    assert watch.look(1.0, at_work(60.0), IDLE) == ""
    assert watch.look(1.0, at_work(61.0), IDLE) == "depth worker: CameraInfo has not finished in 61 s"
    assert watch.look(1.0, at_work(61.0, slow=True), IDLE) == "", "what may take long"
    assert "in 301 s" in watch.look(1.0, at_work(301.0, slow=True), IDLE)
    assert "in 61 s" in HangWatch(LIMITS).look(1.0, beat([(61.0, False, "depth: callback")]), IDLE)


def test_nobody_is_judged_for_the_time_in_which_the_watch_lay_still() -> None:
    watch = HangWatch(LIMITS)
    watch.look(1.0, beat(WELL), IDLE)
    # Others had to wait for the runner, and say so.
    blocked = beat([(3000.0, False, "depth worker: CameraInfo")])
    assert watch.look(3600.0, blocked, IDLE) == ""
    assert watch.look(1.0, blocked, IDLE) == ""
    assert watch.look(1.0, beat(WELL), IDLE) == ""
    for _ in range(10):
        watch.look(1.0, blocked, IDLE)
    assert "3000 s" in watch.look(1.0, blocked, IDLE)


VOTES, POSES = "/ridge/north/fuel/votes", "/ridge/north/posed/pose"
DEAF = WatchdogConfig(deaf=30.0)


class Speaker:
    """A process that sends on topics, one message of each in a second."""

    def __init__(self, traffic: GraphTraffic, *topics: str, name: str = "cameras") -> None:
        self.traffic, self.name = traffic, name
        self.said = dict.fromkeys(topics, 0)
        traffic.begin(name)

    def speak(self, messages: int = 1) -> None:
        self.said = {topic: count + messages for topic, count in self.said.items()}
        self.traffic.take(self.name, self.said)

    def start_again(self) -> None:
        self.said = dict.fromkeys(self.said, 0)
        self.traffic.begin(self.name)


def deaf_after(watch: HearingWatch, speaker: Speaker, heard: dict[str, int], seconds: int, every: int = 1) -> int:
    """Seconds after which it is taken to be deaf that hears nothing more; 0: it never is."""
    for second in range(1, seconds + 1):
        if second % every == 0:
            speaker.speak()
        if watch.look(1.0, heard):
            return second
    return 0


def test_one_that_hears_nothing_while_others_speak_is_deaf_and_says_what_it_missed() -> None:
    traffic = GraphTraffic()
    speaker, watch = Speaker(traffic, VOTES, POSES), HearingWatch("fuel_map", traffic, 30.0)
    speaker.speak(1000)
    watch.look(1.0, {VOTES: 0})
    assert deaf_after(watch, speaker, {VOTES: 0}, 100) == 31
    assert watch.deaf
    assert watch.look(1.0, {VOTES: 0}) == f"received 0 of 31 messages in 32 s, most of them on {VOTES}"


def test_the_watch_hears_of_it_by_heartbeats_and_judges_no_start_and_no_pause_of_its_own() -> None:
    traffic = GraphTraffic()
    idle = ProcessUse("S", 0.0)
    listener = HangWatch(DEAF, hearing=HearingWatch("fuel_map", traffic, DEAF.deaf))
    speaker = HangWatch(DEAF, hearing=HearingWatch("cameras", traffic, DEAF.deaf))
    sent = 0

    def pass_by(seconds: int, turns: list[tuple[float, bool, str]], elapsed_s: float = 1.0) -> tuple[int, str]:
        nonlocal sent
        for second in range(1, seconds + 1):
            sent += 1
            assert speaker.look(elapsed_s, beat(WELL, {VOTES: sent}), idle) == ""
            told = beat(turns, heard={VOTES: 0})
            found = listener.look(elapsed_s / 2, told[:20], idle) or listener.look(elapsed_s / 2, told[20:], idle)
            if found:
                return second, found
        return seconds, ""

    assert pass_by(200, [(1.0, True, "start: ltm_ros.nodes.fuel_map")]) == (200, "")
    assert pass_by(25, WELL) == (25, "")
    assert pass_by(1, WELL, elapsed_s=3600.0) == (1, "")
    second, why = pass_by(100, WELL)
    assert 30 <= second <= 33
    assert why.startswith("received 0 of ")


def test_few_messages_are_not_enough_and_slow_cameras_are_waited_for() -> None:
    traffic = GraphTraffic()
    speaker, watch = Speaker(traffic, VOTES), HearingWatch("fuel_map", traffic, 30.0)
    assert deaf_after(watch, speaker, {VOTES: 0}, 1000, every=60) == 600, "with the tenth"
