"""Which frames of an archive are chosen."""

from __future__ import annotations

import pytest

from ltm_core.errors import ArchiveError
from ltm_ros.archive.manifest import DAY_NS, ArchiveFrame
from ltm_ros.archive.sampling import Sample, sampled

HOUR_NS = DAY_NS // 24


def frame(camera: str, stamp_ns: int) -> ArchiveFrame:
    return ArchiveFrame(camera, stamp_ns, "a.mcap", "/ridge/image", stamp_ns, 5, "", (), (), (), ())


FRAMES = [
    frame(camera, day * DAY_NS + hour * HOUR_NS) for camera in ("east", "west") for day in (3, 4) for hour in range(24)
]


def test_all_is_all() -> None:
    assert sampled(FRAMES, Sample.parsed("all")) == FRAMES


def test_a_few_a_day_are_spread_over_each_camera_s_day() -> None:
    chosen = sampled(FRAMES, Sample.parsed("4/day"))
    assert len(chosen) == 2 * 2 * 4
    hours = [(f.stamp_ns % DAY_NS) // HOUR_NS for f in chosen if f.camera == "west" and f.stamp_ns < 4 * DAY_NS]
    assert hours == [3, 9, 15, 21]
    assert chosen == sorted(chosen, key=lambda f: (f.camera, f.stamp_ns))


def test_one_an_hour_leaves_what_has_no_more() -> None:
    assert sampled(FRAMES, Sample.parsed("1/hour")) == FRAMES
    assert sampled(FRAMES[:1], Sample.parsed("4/day")) == FRAMES[:1]


def test_another_day_moves_no_choice() -> None:
    first_day = [f for f in FRAMES if f.stamp_ns < 4 * DAY_NS]
    sample = Sample.parsed("3/day")
    assert [f for f in sampled(FRAMES, sample) if f.stamp_ns < 4 * DAY_NS] == sampled(first_day, sample)


@pytest.mark.parametrize("text", ["", "0/day", "4", "4/week", "-1/day", "some"])
def test_other_words_are_refused(text: str) -> None:
    with pytest.raises(ArchiveError, match="write all, or a number a span"):
        Sample.parsed(text)


@pytest.mark.parametrize("text", ["all", "4/day", "12/hour"])
def test_says_itself(text: str) -> None:
    assert Sample.parsed(text).described == text
