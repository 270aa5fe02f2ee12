"""Chooses frames of an archive: looks of one view within a day tell nearly the same, so a few of them tell almost all.

The frames of a camera's day or hour are cut into as many parts as looks are wanted, by daylight alone on days that have
any, and of each part the first clear picture is taken, from its first or its third quarter outwards, by turns: light
comes from another side each hour, and two days together have looks of all of them. A picture that the camera had sent
before, on that day or the last one before it, is no new look. A choice hangs on nothing else outside its own span.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ltm_core.errors import ArchiveError
from ltm_core.site import Site
from ltm_core.sun import sun_elevation
from ltm_core.utc_time import DAY_NS
from ltm_ros.archive.manifest import ArchiveFrame

_SPANS = {"hour": DAY_NS // 24, "day": DAY_NS}
_DAYLIGHT = np.radians(5.0)
"""Of the sun, from which on a picture can be clear."""

_QUARTERS = 0.25, 0.75
"""Of a part, where a look is wanted: of what changes over the day, two such are four times as near to the mean of all
as the middle is."""

Look = Callable[[ArchiveFrame], str]
"""Why a frame's picture shows too little; empty: it is clear."""


@dataclass(frozen=True)
class Sample:
    """`count` frames of each camera a span of `span_ns`; 0: all."""

    count: int = 0
    span_ns: int = DAY_NS

    @classmethod
    def parsed(cls, text: str) -> Sample:
        """From `all`, `4/day` or `1/hour`. Raises ArchiveError."""
        if text == "all":
            return cls()
        found = re.fullmatch(r"([1-9][0-9]*)/(hour|day)", text)
        if found is None:
            raise ArchiveError(f"sample {text!r}: write all, or a number a span such as 4/day or 1/hour")
        return cls(int(found[1]), _SPANS[found[2]])

    @property
    def described(self) -> str:
        if self.count == 0:
            return "all"
        return f"{self.count}/{next(name for name, span in _SPANS.items() if span == self.span_ns)}"


@dataclass(frozen=True)
class Sampled:
    """`frames`: the chosen ones, by camera and stamp. `passed_over`: pictures that were looked at and not clear, by
    reason."""

    frames: tuple[ArchiveFrame, ...]
    passed_over: Counter[str]


def solar_day(stamp_ns: int, longitude: float) -> int:
    """Whole days since 1970 that begin at the middle of the night; `longitude`: radians east."""
    return (stamp_ns + _shift(longitude)) // DAY_NS


def spans(frames: Sequence[ArchiveFrame], sample: Sample, longitude: float) -> list[list[ArchiveFrame]]:
    """Frames of one camera and span each; frames come by camera and stamp. `longitude`: radians east, so that days
    begin at the middle of the site's night.
    """
    found: dict[tuple[str, int], list[ArchiveFrame]] = {}
    for frame in frames:
        found.setdefault((frame.camera, span_number(frame.stamp_ns, sample, longitude)), []).append(frame)
    return list(found.values())


def span_number(stamp_ns: int, sample: Sample, longitude: float) -> int:
    """Spans since 1970, as `spans` has them."""
    return (stamp_ns + _shift(longitude)) // sample.span_ns


def repeated(frames: Sequence[ArchiveFrame], longitude: float) -> set[tuple[str, int]]:
    """Camera and stamp of frames whose picture the camera had sent before: on the same solar day, or on the last day
    before it of which there are frames. So a picture that stands still for weeks is one look, wherever weeks are cut.

    Frames come by camera and stamp, all that there are.
    """
    found = set[tuple[str, int]]()
    before, today, of = set[str](), set[str](), ("", 0)
    for frame in frames:
        day = frame.camera, solar_day(frame.stamp_ns, longitude)
        if day != of:
            before, today, of = (today if day[0] == of[0] else set()), set(), day
        if frame.content in before or frame.content in today:
            found.add((frame.camera, frame.stamp_ns))
        today.add(frame.content)
    return found


def sampled(frames: Sequence[ArchiveFrame], sample: Sample, look: Look, turn: int) -> Sampled:
    """Of the frames of one span, in daylight where any are: see above. `turn`: the number of the span."""
    if len(frames) <= sample.count:
        return Sampled(tuple(frames), Counter())
    chosen, passed = list[ArchiveFrame](), Counter[str]()
    for which, part in enumerate(np.array_split(np.arange(len(frames)), sample.count)):
        for number in _outwards(part.tolist(), _QUARTERS[(turn + which) % 2]):
            if not (reason := look(frames[number])):
                chosen.append(frames[number])
                break
            passed[reason] += 1
    return Sampled(tuple(chosen), passed)


def in_daylight(frames: Sequence[ArchiveFrame], site: Site) -> list[ArchiveFrame]:
    """Those taken while the sun is up at the site; all of a day on which it never is, as in a polar night."""
    longitude, latitude = place_of(site)
    up = sun_elevation(latitude, longitude, [frame.stamp_ns for frame in frames]) > _DAYLIGHT
    days = [solar_day(frame.stamp_ns, longitude) for frame in frames]
    dark = {day for day in set(days) if not _sun_rises(day, latitude, longitude)}
    return [frame for frame, bright, day in zip(frames, up, days, strict=True) if bright or day in dark]


def _sun_rises(day: int, latitude: float, longitude: float) -> bool:
    """Within a solar day, told by its noon: the sun's height hangs on the date and the place alone."""
    noon = day * DAY_NS + DAY_NS // 2 - _shift(longitude)
    # Clocks of the sun are up to 17 minutes off those of the mean sun.
    minutes = np.arange(-20, 21, 5) * 60 * 10**9
    return bool((sun_elevation(latitude, longitude, (noon + minutes).tolist()) > _DAYLIGHT).any())


def _shift(longitude: float) -> int:
    """Nanoseconds by which the mean sun is ahead of UTC."""
    return round(longitude / (2 * np.pi) * DAY_NS)


def place_of(site: Site) -> tuple[float, float]:
    """Longitude and latitude of a site's origin, radians."""
    longitude, latitude = site.frame.to_lonlat(0.0, 0.0)
    return float(np.radians(longitude)), float(np.radians(latitude))


def _outwards(numbers: Sequence[int], begin: float) -> Iterator[int]:
    """From a share `begin` of them on, to both sides."""
    place = numbers[0] + begin * len(numbers) - 0.5
    return iter(sorted(numbers, key=lambda number: (abs(number - place), number)))
