from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from scenes.small_site import write_small_site

from ltm_core.base.utc_time import DAY_NS
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.sampling import (
    Look,
    Sample,
    in_daylight,
    repeated,
    sampled,
    spans,
)

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


FOUR = Sample.parsed("4/day")
DAY = FRAMES[6:18]
"""Pictures of an hour each, of a day on which the sun is up from 6 to 18 h."""
TURNS = range(16)


def chosen(frames: Sequence[ArchiveFrame], turn: int, look: Look = clear) -> list[int]:
    """Hours of what is taken of such a day."""
    return hours(sampled(frames, FOUR, look, turn, 12 * HOUR_NS).frames)


def test_looks_are_spread_over_a_day_and_begin_elsewhere_on_the_next() -> None:
    assert chosen(DAY, 0) == [6, 9, 12, 15]
    assert chosen(DAY, 1) == [7, 10, 13, 16]
    taken = [hour for turn in TURNS for hour in chosen(DAY, turn)]
    assert {hour: taken.count(hour) for hour in range(6, 18)} == {6 + k: (5, 6, 5)[k % 3] for k in range(12)}


def test_clear_hours_alone_have_looks_and_each_as_often() -> None:
    """Fog until 9 h, glare at 14 h: eight hours of twelve, so two or three looks."""

    def look(frame: ArchiveFrame) -> str:
        (hour,) = hours([frame])
        return "fog" if hour < 9 else "glare" if hour == 14 else ""

    found = sampled(DAY, FOUR, look, 0, 12 * HOUR_NS)
    assert (hours(found.frames), found.passed_over) == ([9, 12, 16], {"fog": 3, "glare": 1})
    taken = [hour for turn in TURNS for hour in chosen(DAY, turn, look)]
    assert {taken.count(hour) for hour in (9, 10, 11, 12, 13, 15, 16, 17)} == {5, 6}
    assert len(taken) == sum(taken.count(hour) for hour in (9, 10, 11, 12, 13, 15, 16, 17))


def test_daylight_is_the_site_s_and_of_each_day(tmp_path: Path) -> None:
    """Of early January in California: from 16 to 1 h UTC."""
    site = write_small_site(tmp_path, recording=False).site
    assert hours(in_daylight(FRAMES[:24], site)) == [0, *range(16, 24)]
    # A camera that only sent by night is not taken by night for it, whatever it sent on other days.
    assert in_daylight(FRAMES[5:8], site) == []
    assert hours(in_daylight([*FRAMES[5:8], *FRAMES[40:42]], site)) == [16, 17]


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
