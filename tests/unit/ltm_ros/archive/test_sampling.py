"""Which frames of an archive are chosen."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pytest
import yaml
from scenes.small_site import write_small_site

from ltm_core.errors import ArchiveError
from ltm_core.site_io import load_site
from ltm_core.utc_time import DAY_NS
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.sampling import Sample, in_daylight, repeated, sampled, solar_day, spans

HOUR_NS = DAY_NS // 24


def frame(camera: str, stamp_ns: int, content: str = "") -> ArchiveFrame:
    return ArchiveFrame(camera, stamp_ns, "a.mcap", "/ridge/image", stamp_ns, 5, content, (), (), (), ())


FRAMES = [
    frame(camera, day * DAY_NS + hour * HOUR_NS) for camera in ("east", "west") for day in (3, 4) for hour in range(24)
]


def clear(frame: ArchiveFrame) -> str:
    return ""


def hours(frames: Iterable[ArchiveFrame]) -> list[int]:
    return [(frame.stamp_ns % DAY_NS) // HOUR_NS for frame in frames]


def test_a_span_is_of_one_camera_and_day() -> None:
    found = spans(FRAMES, Sample.parsed("4/day"), 0.0)
    assert [(span[0].camera, span[0].stamp_ns // DAY_NS, len(span)) for span in found] == [
        *(("east", 3, 24), ("east", 4, 24), ("west", 3, 24), ("west", 4, 24))
    ]
    assert len(spans(FRAMES, Sample.parsed("1/hour"), 0.0)) == len(FRAMES)


def test_days_begin_in_the_site_s_night() -> None:
    """At 120 degrees west, at 8 h UTC."""
    found = spans(FRAMES[:48], Sample.parsed("4/day"), -2 * np.pi / 3)
    assert [hours(span)[0] for span in found] == [0, 8, 8]


def test_looks_are_spread_over_a_day() -> None:
    sample = Sample.parsed("4/day")
    assert sampled(FRAMES[:3], sample, clear, 0).frames == tuple(FRAMES[:3])
    even, odd = (hours(sampled(FRAMES[:24], sample, clear, turn).frames) for turn in (0, 1))
    assert (even, odd) == ([1, 10, 13, 22], [4, 7, 16, 19])


def test_two_days_together_show_what_changes_over_a_day_as_all_of_its_hours_do() -> None:
    """Of a parabola."""
    every = [frame("east", minute * HOUR_NS // 60) for minute in range(24 * 60)]

    def mean(frames: Sequence[ArchiveFrame]) -> float:
        return float(np.mean([(one.stamp_ns / HOUR_NS - 12) ** 2 for one in frames]))

    looks = [one for turn in (0, 1) for one in sampled(every, Sample.parsed("4/day"), clear, turn).frames]
    middles = [every[60 * hour] for hour in (3, 9, 15, 21)]
    assert abs(mean(middles) - mean(every)) > 2.5
    assert abs(mean(looks) - mean(every)) < 0.8


def test_of_each_part_the_first_clear_one_from_there_is_taken() -> None:
    """Fog until 9 h, glare at 14 h, a night from 18 h on."""

    def look(frame: ArchiveFrame) -> str:
        (hour,) = hours([frame])
        return "fog" if hour < 9 else "glare" if hour == 14 else "night" if hour >= 18 else ""

    found = sampled(FRAMES[:24], Sample.parsed("4/day"), look, 0)
    assert hours(found.frames) == [10, 13]
    assert found.passed_over == {"fog": 6, "night": 6}
    other = sampled(FRAMES[:24], Sample.parsed("4/day"), look, 1)
    assert hours(other.frames) == [9, 16]
    assert other.passed_over == {"fog": 6 + 3, "night": 6}


def test_daylight_is_the_site_s_and_of_each_day(tmp_path: Path) -> None:
    """Of early January in California: from 16 to 1 h UTC."""
    site = write_small_site(tmp_path, recording=False).site
    assert hours(in_daylight(FRAMES[:24], site)) == [0, *range(16, 24)]
    # A camera that only sent by night is not taken by night for it, whatever it sent on other days.
    assert in_daylight(FRAMES[5:8], site) == []
    assert hours(in_daylight([*FRAMES[5:8], *FRAMES[40:42]], site)) == [16, 17]


def test_days_without_a_sun_are_taken_whole_and_others_not_for_their_sake(tmp_path: Path) -> None:
    """At 78 degrees north the sun stays down in January and up in June; in the middle of March it rises by noon."""
    write_small_site(tmp_path, recording=False)
    content = yaml.safe_load((tmp_path / "site.yaml").read_text())
    content |= {"crs": "EPSG:32633", "origin": [500_000.0, 8_658_000.0]}
    (tmp_path / "site.yaml").write_text(yaml.safe_dump(content))
    site = load_site(tmp_path / "site.yaml")
    begins = {name: int(np.datetime64(f"2026-{name}", "D").astype(int)) for name in ("01-10", "03-25", "06-20")}
    days = {name: [frame("east", day * DAY_NS + hour * HOUR_NS) for hour in range(24)] for name, day in begins.items()}
    found = {name: hours(in_daylight(frames, site)) for name, frames in days.items()}
    assert found["01-10"] == found["06-20"] == list(range(24))
    assert 5 < len(found["03-25"]) < 15
    assert 11 in found["03-25"]
    together = in_daylight([frame for frames in days.values() for frame in frames], site)
    assert hours(together) == [hour for name in days for hour in found[name]]


def test_a_picture_that_stands_still_for_weeks_is_one_look() -> None:
    """From the sixth hour of the first day on, for three weeks, and a day without frames among them."""
    days = [day for day in range(40, 62) if day != 50]
    frames = [
        frame("east", day * DAY_NS + hour * HOUR_NS, "still" if (day, hour) >= (40, 6) else f"{hour}")
        for day in days
        for hour in range(24)
    ]
    found = repeated(frames, 0.0)
    assert len(found) == len(frames) - 7
    assert ("east", 40 * DAY_NS + 6 * HOUR_NS) not in found


def test_another_camera_s_picture_and_one_of_long_ago_are_no_repetition() -> None:
    frames = [frame("east", 0, "a"), frame("east", DAY_NS, "b"), frame("east", 2 * DAY_NS, "a"), frame("west", 0, "a")]
    assert repeated(frames, 0.0) == set()
    assert repeated([*frames[:2], frame("east", DAY_NS + 1, "a")], 0.0) == {("east", DAY_NS + 1)}


def test_a_choice_hangs_on_its_own_days_and_the_one_before() -> None:
    """Wherever an archive is cut, what is found of all days but the first is the same."""
    rng = np.random.default_rng(4)
    frames = [frame("east", hour * HOUR_NS, str(rng.integers(30))) for hour in range(0, 24 * 12, 3)]
    whole = repeated(frames, 0.3)
    assert whole
    for day in range(1, 12):
        cut = [one for one in frames if solar_day(one.stamp_ns, 0.3) >= day]
        later = {key for key in whole if solar_day(key[1], 0.3) > day}
        assert {key for key in repeated(cut, 0.3) if solar_day(key[1], 0.3) > day} == later


@pytest.mark.parametrize("text", ["", "0/day", "4", "4/week", "-1/day", "some"])
def test_other_words_are_refused(text: str) -> None:
    with pytest.raises(ArchiveError, match="write all, or a number a span"):
        Sample.parsed(text)


@pytest.mark.parametrize("text", ["all", "4/day", "12/hour"])
def test_says_itself(text: str) -> None:
    assert Sample.parsed(text).described == text
