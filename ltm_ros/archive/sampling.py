"""Choose the frames of an archive that a sample takes, and store each choice.

Frames of one view within a day are nearly equal, so a few of them are enough.

The mean of the sample must be that of all frames. A view changes with light and weather, so each clear image represents
the time around it, and frames are taken at even steps along the time covered by clear images, in daylight only on days
that have any; foggy hours are not represented. The start of the first step alternates from span to span, so that
several days cover all hours. An image that the camera sent before, on the same day or the last one, does not count.
Nothing else outside its span affects a choice."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import ArchiveError
from ltm_core.base.number_text import DAY_NS
from ltm_core.base.types import Int64Array
from ltm_core.geometry.geodesy import sun_elevation
from ltm_core.site.site import Site
from ltm_ros.archive.content_digest import code_digest, digest, look_digest
from ltm_ros.archive.files import ResultFolder
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.pictures import ArchiveImageReader, SmallLook

_SPANS = {"hour": DAY_NS // 24, "day": DAY_NS}
_DAYLIGHT = 0.0
"""Sun height in radians from which an image can be clear. Dim images under a low sun are rejected by their content; a
sample without the usable ones would differ from live operation."""
_ASKED = 4
"""Maximum number of images that are checked per sampled frame."""
_PHASES = 16
"""Number of positions of the first step, a power of two."""
_DAYLIGHT_STEP_NS = 5 * 60 * 10**9
"""Step in ns for measuring the daylight of a span."""

Look = Callable[[ArchiveFrame], str]
"""Returns why a frame's image is unusable; empty: it is clear."""


@dataclass(frozen=True)
class Sample:
    """`count` frames of each camera per span of `span_ns`; 0: all."""

    count: int = 0
    span_ns: int = DAY_NS

    @classmethod
    def parsed(cls, text: str) -> Sample:
        """Parse `all`, `4/day` or `1/hour`. Raises ArchiveError."""
        if text == "all":
            return cls()
        found = re.fullmatch(r"([1-9][0-9]*)/(hour|day)", text)
        if found is None:
            raise ArchiveError(f"sample {text!r}: give all, or a number per time span such as 4/day or 1/hour")
        return cls(int(found[1]), _SPANS[found[2]])

    @property
    def described(self) -> str:
        if self.count == 0:
            return "all"
        return f"{self.count}/{next(name for name, span in _SPANS.items() if span == self.span_ns)}"


@dataclass(frozen=True)
class Sampled:
    """`frames`: the chosen ones, by camera and stamp. `passed_over`: images found not clear, by reason."""

    frames: tuple[ArchiveFrame, ...]
    passed_over: Counter[str]


def solar_day(stamp_ns: int, longitude: float) -> int:
    """Return whole days since 1970 that begin at solar midnight; `longitude`: radians east."""
    return (stamp_ns + _shift(longitude)) // DAY_NS


def spans(frames: Sequence[ArchiveFrame], sample: Sample, longitude: float) -> list[list[ArchiveFrame]]:
    """Group frames by camera and span; frames come by camera and stamp. `longitude`: radians east, so that days begin
    at the site's solar midnight."""
    found: dict[tuple[str, int], list[ArchiveFrame]] = {}
    for frame in frames:
        found.setdefault((frame.camera, span_number(frame.stamp_ns, sample, longitude)), []).append(frame)
    return list(found.values())


def span_number(stamp_ns: int, sample: Sample, longitude: float) -> int:
    """Return the number of spans since 1970, as in `spans`."""
    return (stamp_ns + _shift(longitude)) // sample.span_ns


def repeated(frames: Sequence[ArchiveFrame], longitude: float) -> set[tuple[str, int]]:
    """Return camera and stamp of frames whose image the camera sent before: on the same solar day, or on its last day
    with frames. So an image frozen for weeks counts once.

    Frames come by camera and stamp, complete."""
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


def sampled(frames: Sequence[ArchiveFrame], sample: Sample, look: Look, turn: int, lit_ns: int) -> Sampled:
    """Choose frames of one span, in daylight if there is any. `turn`: the number of the span; `lit_ns`: its daylight.
    At least one is chosen if any checked image is clear."""
    asked = _evenly(frames, _ASKED * sample.count)
    if not asked:
        return Sampled((), Counter())
    stands_for = _times(np.array([frame.stamp_ns for frame in asked], np.int64), max(lit_ns // sample.count, 1))
    reasons = [look(frame) for frame in asked]
    passed = Counter(reason for reason in reasons if reason)
    clear = [number for number, reason in enumerate(reasons) if not reason]
    if not clear:
        return Sampled((), passed)
    ends = np.cumsum(stands_for[clear])
    step = max(lit_ns, int(stands_for.sum())) // sample.count
    begin = step * (2 * _reversed(turn % _PHASES) + 1) // (2 * _PHASES)
    places = np.arange(begin, ends[-1], step)
    if not places.size:
        places = np.array([int(ends[-1]) * begin // step])
    chosen = np.unique(np.searchsorted(ends, places, side="right"))
    return Sampled(tuple(asked[clear[number]] for number in chosen.tolist()), passed)


def daylight_ns(turn: int, sample: Sample, site: Site) -> int:
    """Return the duration of daylight at the site within a span; the whole span if the sun never rises."""
    longitude, latitude = place_of(site)
    begin = turn * sample.span_ns - _shift(longitude)
    at = begin + np.arange(0, sample.span_ns, _DAYLIGHT_STEP_NS)
    up = int((sun_elevation(latitude, longitude, at) > _DAYLIGHT).sum())
    return up * _DAYLIGHT_STEP_NS if up else sample.span_ns


def _evenly(frames: Sequence[ArchiveFrame], most: int) -> Sequence[ArchiveFrame]:
    """Return at most `count` of them, from the middles of as many parts."""
    if len(frames) <= most:
        return frames
    return [frames[(2 * part + 1) * len(frames) // (2 * most)] for part in range(most)]


def _times(stamps: Int64Array, most: int) -> Int64Array:
    """Return the time (N,) in ns that each of rising stamps represents: half the distance to both neighbours,
    symmetrical at the ends; at most `most`, which also holds for a single one."""
    if len(stamps) == 1:
        return np.array([most], np.int64)
    ways = np.diff(stamps)
    both = np.concatenate([ways[:1], ways]) + np.concatenate([ways, ways[-1:]])
    clipped: Int64Array = np.clip(both // 2, 1, most)
    return clipped


def _reversed(number: int) -> int:
    """Return its bits in reverse order, below `_PHASES`: consecutive numbers become evenly spread (van der Corput's
    sequence)."""
    found = 0
    for _ in range(_PHASES.bit_length() - 1):
        found, number = 2 * found + number % 2, number // 2
    return found


def in_daylight(frames: Sequence[ArchiveFrame], site: Site) -> list[ArchiveFrame]:
    """Return the frames in daylight; all of a day without any, as in a polar night."""
    longitude, latitude = place_of(site)
    up = sun_elevation(latitude, longitude, [frame.stamp_ns for frame in frames]) > _DAYLIGHT
    days = [solar_day(frame.stamp_ns, longitude) for frame in frames]
    dark = {day for day in set(days) if not _sun_rises(day, latitude, longitude)}
    return [frame for frame, bright, day in zip(frames, up, days, strict=True) if bright or day in dark]


def _sun_rises(day: int, latitude: float, longitude: float) -> bool:
    """Return whether the sun rises within a solar day, given its noon: this depends only on date and place."""
    noon = day * DAY_NS + DAY_NS // 2 - _shift(longitude)
    # Solar noon differs by up to 17 minutes from that of the mean sun.
    minutes = np.arange(-20, 21, 5) * 60 * 10**9
    return bool((sun_elevation(latitude, longitude, (noon + minutes).tolist()) > _DAYLIGHT).any())


def _shift(longitude: float) -> int:
    """Return the nanoseconds by which the mean sun is ahead of UTC."""
    return round(longitude / (2 * np.pi) * DAY_NS)


def place_of(site: Site) -> tuple[float, float]:
    """Return longitude and latitude of a site's origin in radians."""
    longitude, latitude = site.frame.to_lonlat(0.0, 0.0)
    return float(np.radians(longitude)), float(np.radians(latitude))


LOOKS = "looks"
REPEATED = "repeated: the camera sent the same image before"


def chosen(
    frames: Sequence[ArchiveFrame],
    within: tuple[int, int],
    sample: Sample,
    site: Site,
    results: ResultFolder,
) -> tuple[list[ArchiveFrame], Counter[str]]:
    """Choose the sample from all `frames` of an archive, by camera and stamp, with stamps `within`, both inclusive;
    also return the number of unclear images, by reason. Raises ArchiveError, OSError if an image cannot be read now."""
    longitude, _ = place_of(site)
    still = repeated(frames, longitude)
    taken, passed = list[ArchiveFrame](), Counter[str]()
    asked = [frame for frame in frames if within[0] <= frame.stamp_ns <= within[1]]
    reader = ArchiveImageReader()
    looks = {camera: SmallLook(site, camera, reader) for camera in {frame.camera for frame in asked}}
    for span in spans(in_daylight(asked, site), sample, longitude):
        new = [frame for frame in span if (frame.camera, frame.stamp_ns) not in still]
        if repeats := len(span) - len(new):
            passed[REPEATED] += repeats
        camera = span[0].camera
        turn = span_number(span[0].stamp_ns, sample, longitude)
        lit = daylight_ns(turn, sample, site)
        when = [sample.described, turn, lit]
        of = [code_digest(), look_digest(site, camera), *when, [frame.identity() for frame in new]]
        name = f"{LOOKS}/{digest(*of)}.json"
        if not results.has(name):
            found = sampled(new, sample, looks[camera], turn, lit)
            kept = {"stamps": [frame.stamp_ns for frame in found.frames], "passed_over": found.passed_over}
            results.write(name, json.dumps(kept).encode())
        known = json.loads(results.read(name))
        stamps = set(known["stamps"])
        taken += [frame for frame in new if frame.stamp_ns in stamps]
        passed.update(known["passed_over"])
    return taken, passed
