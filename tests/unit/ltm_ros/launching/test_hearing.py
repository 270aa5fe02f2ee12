"""Which process of a graph is taken to hear nothing."""

from __future__ import annotations

import json

from ltm_core.site.sections import WatchdogConfig
from ltm_ros.launching.watchdog import GraphTraffic, HangWatch, HearingWatch, ProcessUse

VOTES, POSES = "/ridge/north/fuel/votes", "/ridge/north/posed/pose"
WELL: list[tuple[float, bool, str]] = [(0.0, False, "fuel_map: callback")]
LIMITS = WatchdogConfig(deaf=30.0)


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


def test_one_that_hears_anything_whoever_says_it_is_well() -> None:
    traffic = GraphTraffic()
    speaker, watch = Speaker(traffic, VOTES), HearingWatch("fuel_map", traffic, 30.0)
    for second in range(300):
        speaker.speak()
        # Of the votes nothing comes through (they may be too large), of what a stranger asks one each 20 s does.
        assert watch.look(1.0, {VOTES: 0, "/ridge/fuel_map/query": second // 20}) == ""
    assert not watch.deaf


def test_silence_and_what_nobody_listens_to_make_nobody_deaf() -> None:
    traffic = GraphTraffic()
    speaker, watch = Speaker(traffic, POSES), HearingWatch("fuel_map", traffic, 30.0)
    assert deaf_after(watch, speaker, {VOTES: 0}, 1000) == 0
    # What a process says itself it need not hear: its nodes hand that to each other.
    own = Speaker(traffic, VOTES, name="fuel_map")
    assert deaf_after(watch, own, {VOTES: 0}, 1000) == 0


def test_a_burst_after_a_night_of_silence_has_its_time_to_come_through() -> None:
    traffic = GraphTraffic()
    speaker, watch = Speaker(traffic, VOTES), HearingWatch("fuel_map", traffic, 30.0)
    for _ in range(30_000):
        assert watch.look(1.0, {VOTES: 7}) == ""
    speaker.speak(500)
    assert watch.look(1.0, {VOTES: 7}) == ""
    assert watch.look(1.0, {VOTES: 500}) == ""
    assert deaf_after(watch, speaker, {VOTES: 500}, 100) == 31, "and one that falls deaf later is noticed"


def test_few_messages_are_not_enough_and_slow_cameras_are_waited_for() -> None:
    traffic = GraphTraffic()
    speaker, watch = Speaker(traffic, VOTES), HearingWatch("fuel_map", traffic, 30.0)
    assert deaf_after(watch, speaker, {VOTES: 0}, 1000, every=60) == 600, "with the tenth"


def test_a_speaker_that_starts_again_counts_from_nothing() -> None:
    traffic = GraphTraffic()
    speaker, watch = Speaker(traffic, VOTES), HearingWatch("fuel_map", traffic, 30.0)
    for _ in range(20):
        assert deaf_after(watch, speaker, {VOTES: 0}, 1) == 0
    speaker.start_again()
    assert deaf_after(watch, speaker, {VOTES: 0}, 100) == 12
    # And one that was listened to from later on has missed nothing before.
    assert deaf_after(HearingWatch("terrain", traffic, 30.0), speaker, {VOTES: 0}, 100) == 32


def line(content: object) -> bytes:
    return json.dumps(content).encode() + b"\n"


def test_the_watch_hears_of_it_by_heartbeats_and_judges_no_start_and_no_pause_of_its_own() -> None:
    traffic = GraphTraffic()
    idle = ProcessUse("S", 0.0)
    listener = HangWatch(LIMITS, hearing=HearingWatch("fuel_map", traffic, LIMITS.deaf))
    speaker = HangWatch(LIMITS, hearing=HearingWatch("cameras", traffic, LIMITS.deaf))
    sent = 0

    def pass_by(seconds: int, beat: list[tuple[float, bool, str]], elapsed_s: float = 1.0) -> tuple[int, str]:
        nonlocal sent
        for second in range(1, seconds + 1):
            sent += 1
            assert speaker.look(elapsed_s, line({"said": {VOTES: sent}, "heard": {}}) + line(WELL), idle) == ""
            told = line({"said": {}, "heard": {VOTES: 0}}) + line(beat)
            # Its counts and its beat may come apart.
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
