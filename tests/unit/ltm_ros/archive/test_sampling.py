"""Which frames of an archive are chosen."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from scenes.small_site import write_small_site

from ltm_core.errors import ArchiveError
from ltm_ros.archive.manifest import DAY_NS, ArchiveFrame
from ltm_ros.archive.sampling import Sample, in_daylight, sampled, spans

HOUR_NS = DAY_NS // 24


def frame(camera: str, stamp_ns: int) -> ArchiveFrame:
    return ArchiveFrame(camera, stamp_ns, "a.mcap", "/ridge/image", stamp_ns, 5, "", (), (), (), ())


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
    assert hours(sampled(FRAMES[:24], Sample.parsed("4/day"), clear).frames) == [2, 8, 14, 20]
    assert sampled(FRAMES[:3], Sample.parsed("4/day"), clear).frames == tuple(FRAMES[:3])


def test_of_each_part_the_first_clear_one_from_the_middle_is_taken() -> None:
    """Fog until 9 h, glare at 14 h, a night from 18 h on."""

    def look(frame: ArchiveFrame) -> str:
        (hour,) = hours([frame])
        return "fog" if hour < 9 else "glare" if hour == 14 else "night" if hour >= 18 else ""

    found = sampled(FRAMES[:24], Sample.parsed("4/day"), look)
    assert hours(found.frames) == [9, 15]
    assert found.passed_over == {"fog": 6 + 1, "glare": 1, "night": 6}


def test_daylight_is_the_site_s(tmp_path: Path) -> None:
    """Of early January in California: from 16 to 1 h UTC."""
    site = write_small_site(tmp_path, recording=False).site
    found = hours(in_daylight(FRAMES[:24], site))
    assert found == [0, *range(16, 24)]
    night = FRAMES[5:8]
    assert in_daylight(night, site) == night


@pytest.mark.parametrize("text", ["", "0/day", "4", "4/week", "-1/day", "some"])
def test_other_words_are_refused(text: str) -> None:
    with pytest.raises(ArchiveError, match="write all, or a number a span"):
        Sample.parsed(text)


@pytest.mark.parametrize("text", ["all", "4/day", "12/hour"])
def test_says_itself(text: str) -> None:
    assert Sample.parsed(text).described == text
