"""Chooses frames of an archive: looks of one view within a day tell nearly the same, so a few of them tell almost all.

The frames of a camera's day or hour are cut into as many parts as looks are wanted, by daylight alone where there is
any, and of each part the first clear picture is taken, from its middle outwards. A choice hangs on nothing outside its
own span.
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
from ltm_ros.archive.manifest import DAY_NS, ArchiveFrame

_SPANS = {"hour": DAY_NS // 24, "day": DAY_NS}
_DAYLIGHT = np.radians(5.0)
"""Of the sun, from which on a picture can be clear."""

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


def spans(frames: Sequence[ArchiveFrame], sample: Sample, longitude: float) -> list[list[ArchiveFrame]]:
    """Frames of one camera and span each; frames come by camera and stamp. `longitude`: radians east, so that days
    begin at the middle of the site's night.
    """
    shift = round(longitude / (2 * np.pi) * DAY_NS)
    found: dict[tuple[str, int], list[ArchiveFrame]] = {}
    for frame in frames:
        found.setdefault((frame.camera, (frame.stamp_ns + shift) // sample.span_ns), []).append(frame)
    return list(found.values())


def sampled(frames: Sequence[ArchiveFrame], sample: Sample, look: Look) -> Sampled:
    """Of the frames of one span, in daylight where any are: see above."""
    if len(frames) <= sample.count:
        return Sampled(tuple(frames), Counter())
    chosen, passed = list[ArchiveFrame](), Counter[str]()
    for part in np.array_split(np.arange(len(frames)), sample.count):
        for number in _from_the_middle(part.tolist()):
            if not (reason := look(frames[number])):
                chosen.append(frames[number])
                break
            passed[reason] += 1
    return Sampled(tuple(chosen), passed)


def in_daylight(frames: Sequence[ArchiveFrame], site: Site) -> list[ArchiveFrame]:
    """Those taken while the sun is up at the site; all where it never is, as in a polar night."""
    longitude, latitude = place_of(site)
    up = sun_elevation(latitude, longitude, [frame.stamp_ns for frame in frames]) > _DAYLIGHT
    return [frame for frame, bright in zip(frames, up, strict=True) if bright] or list(frames)


def place_of(site: Site) -> tuple[float, float]:
    """Longitude and latitude of a site's origin, radians."""
    longitude, latitude = site.frame.to_lonlat(0.0, 0.0)
    return float(np.radians(longitude)), float(np.radians(latitude))


def _from_the_middle(numbers: Sequence[int]) -> Iterator[int]:
    middle = (len(numbers) - 1) / 2
    return iter(sorted(numbers, key=lambda number: (abs(number - numbers[0] - middle), number)))
