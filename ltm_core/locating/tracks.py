"""Assign sightings of several cameras and times to fires, with the pose that each was marked under.

A sighting joins the track that it agrees with best (`Locator.limit`). If it agrees with none but lies in the direction
of one, it begins a track of its own, and the two count as one fire about which its cameras disagree.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ltm_core.base.errors import RegionError
from ltm_core.base.types import Float64Array
from ltm_core.base.utc_time import DAY_NS
from ltm_core.geometry.pose import Pose
from ltm_core.locating.locator import CameraAgreement, Location, Locator
from ltm_core.locating.sighting import Sighting
from ltm_core.locating.wrong_camera import FireMemory, TurnVerdict

MOST = 200
"""Maximum number of poses kept; the least recently received one is dropped first."""


class KnownPoses:
    """Poses with covariances (6, 6), by their stamps in nanoseconds."""

    def __init__(self) -> None:
        self._poses: OrderedDict[int, tuple[Pose, Float64Array]] = OrderedDict()

    def __bool__(self) -> bool:
        return bool(self._poses)

    def add(self, stamp: int, pose: Pose, covariance: Float64Array) -> None:
        self._poses[stamp] = (pose, covariance)
        self._poses.move_to_end(stamp)
        while len(self._poses) > MOST:
            self._poses.popitem(last=False)

    @property
    def newest(self) -> tuple[Pose, Float64Array, int]:
        """Return the last received pose with its stamp. After a clock was set back, earlier poses have later stamps,
        and a PTZ camera has moved since. Raises LookupError without poses."""
        if not self._poses:
            raise LookupError("no pose is known")
        stamp = next(reversed(self._poses))
        return *self._poses[stamp], stamp

    def at(self, stamp: int, age_ns: int) -> tuple[Pose, Float64Array] | None:
        """Return the pose of a stamp, or the last before it; None if none is known then, or within `age_ns` before."""
        earlier = [known for known in self._poses if known <= stamp]
        if not earlier or stamp - max(earlier) > age_ns:
            return None
        return self._poses[max(earlier)]


NEARBY_DEG = 4.0
"""Maximum angle in degrees between a sighting's azimuth and a track's place for both to be the same fire if a camera is
wrong."""


@dataclass(frozen=True, eq=False)
class SeenAt:
    """Sighting with its time and its origin, `detector` or `person`."""

    sighting: Sighting
    stamp_ns: int
    source: str


@dataclass(eq=False)
class Track:
    """Track of one fire. `sightings`: newest last. `fire`: number of the first track of those that may be of the same
    fire if a camera is wrong. `disputed`: cameras that disagree about it. `wrong`: the wrong one of them, once known.
    `closed`: it accepts no more sightings (`Tracks.forget`)."""

    number: int
    sightings: list[SeenAt]
    location: Location
    fire: int
    disputed: frozenset[str] = frozenset()
    wrong: str | None = None
    closed: bool = False

    @property
    def cameras(self) -> list[str]:
        return list(dict.fromkeys(seen.sighting.name for seen in self.sightings))

    @property
    def sources(self) -> list[str]:
        return sorted({seen.source for seen in self.sightings})

    @property
    def first_ns(self) -> int:
        return min(seen.stamp_ns for seen in self.sightings)

    @property
    def last_ns(self) -> int:
        return max(seen.stamp_ns for seen in self.sightings)


@dataclass
class Tracks:
    """The tracks of a site.

    `smoke`: smoke is marked. `lifetime_ns`: after which a track without a new sighting ends. `most`: maximum number of
    tracks, the most recently seen. `of_a_camera`: maximum number of sightings of one camera in a track, the newest.
    `memory_ns`: after which evidence about cameras is forgotten.
    """

    locator: Locator
    smoke: bool = True
    lifetime_ns: int = 3_600_000_000_000
    most: int = 16
    of_a_camera: int = 2
    memory_ns: int = DAY_NS
    tracks: list[Track] = field(default_factory=list)
    fires: FireMemory = field(init=False)
    _next: int = 1
    _named: str | None = None

    def __post_init__(self) -> None:
        self.fires = FireMemory(self.locator.config.sure_of_wrong, self.memory_ns)

    def add(self, seen: SeenAt) -> tuple[Track, Location, str | None]:
        """Add a sighting. Return its track, its own location, and, if it disagrees with a nearby track, the wrong
        camera if known. Raises RegionError, PoseError as `Locator.locate`; nothing changes then."""
        alone = self.locator.locate([seen.sighting], self.smoke)
        self.expire(seen.stamp_ns)
        best: tuple[float, Track, Location] | None = None
        disputes: list[tuple[Track, CameraAgreement]] = []
        for track in self.tracks:
            if track.closed or not _nearby(seen.sighting, track, alone):
                continue
            together = self._kept([*track.sightings, seen])
            try:
                location = self.locator.locate([each.sighting for each in together], self.smoke)
            except RegionError:
                continue
            if _agree(location, self.locator.limit):
                if best is None or location.misfit < best[0]:
                    best = (location.misfit, track, location)
            elif location.agreement is not None:
                disputes.append((track, location.agreement))
        if best is not None:
            _, track, location = best
            track.sightings, track.location = self._kept([*track.sightings, seen]), location
            if location.agreement is not None:
                self.fires.note(track.fire, seen.stamp_ns, location.agreement.turns)
            self.rename()
            return self._with(seen, track), alone, None
        track = Track(self._next, [seen], alone, self._next)
        if disputes:
            other, agreement = max(disputes, key=lambda each: len(each[0].cameras))
            track.fire = other.fire
            track.disputed = other.disputed = frozenset(agreement.turns.ratios)
            self.fires.note(other.fire, seen.stamp_ns, agreement.turns)
        self._next += 1
        self.tracks = sorted([*self.tracks, track], key=lambda each: each.last_ns)[-self.most :]
        self.rename()
        track = self._with(seen, track)
        return track, alone, track.wrong

    def forget(self, camera: str) -> bool:
        """Reset a camera whose mount was fitted again: its earlier marks are not used any more. Return whether there
        were any. A track that only it has marked stays where it is, and takes no more, until it ends."""
        found = self.fires.forget(camera)
        for track in self.tracks:
            if camera in track.disputed:
                track.disputed = frozenset()
            others = [seen for seen in track.sightings if seen.sighting.name != camera]
            if track.closed or len(others) == len(track.sightings):
                continue
            found = True
            try:
                track.location = self.locator.locate([seen.sighting for seen in others], self.smoke)
                track.sightings = others
            except RegionError:  # none, or none that fit without it
                track.closed = True
        self.rename()
        return found

    def rename(self) -> TurnVerdict:
        """Update which camera is wrong in each track by current knowledge, and return it. Tracks that a newly reported
        camera kept apart are merged."""
        verdict = self.fires.verdict
        if verdict.wrong is not None and verdict.wrong != self._named:
            for fire in dict.fromkeys(track.fire for track in self.tracks if verdict.wrong in track.disputed):
                self._reunite(fire, verdict.wrong)
        self._named = verdict.wrong
        for track in self.tracks:
            track.wrong = verdict.wrong if verdict.wrong in track.disputed else None
        return verdict

    def _with(self, seen: SeenAt, track: Track) -> Track:
        """Return the track of a sighting; naming a camera may have moved it from the one that it has joined."""
        return next((one for one in self.tracks if seen in one.sightings), track)

    def _reunite(self, fire: int, wrong: str) -> None:
        """Merge tracks of one fire that a turned camera separated: the marks of the others become one track if they
        agree, those of the turned camera another."""
        open_ones = [track for track in self.tracks if track.fire == fire and not track.closed]
        parts = [(track, [s for s in track.sightings if s.sighting.name != wrong]) for track in open_ones]
        apart = sorted((part for part in parts if part[1]), key=lambda part: part[0].number)
        if len(apart) < 2:
            return
        first, right = apart[0][0], self._kept([seen for _, marks in apart for seen in marks])
        marked = [seen for track in open_ones for seen in track.sightings if seen.sighting.name == wrong]
        try:
            together = self.locator.locate([seen.sighting for seen in right], self.smoke)
            alone = self.locator.locate([seen.sighting for seen in self._kept(marked)], self.smoke) if marked else None
        except RegionError:
            return
        if not _agree(together, self.locator.limit):
            return
        first.sightings, first.location = right, together
        others = [track for track in open_ones if track is not first]
        if alone is not None:
            kept = others.pop(0)
            kept.sightings, kept.location = self._kept(marked), alone
        self.tracks = sorted((t for t in self.tracks if t not in others), key=lambda track: track.last_ns)

    def expire(self, now_ns: int) -> None:
        """End tracks without recent sightings, and drop old evidence about cameras."""
        self.fires.expire(now_ns)
        self.tracks = [track for track in self.tracks if now_ns - track.last_ns <= self.lifetime_ns]

    def _kept(self, sightings: Sequence[SeenAt]) -> list[SeenAt]:
        """Return the newest of each camera."""
        ordered = sorted(sightings, key=lambda each: each.stamp_ns)
        kept: list[SeenAt] = []
        counts: dict[str, int] = {}
        for seen in reversed(ordered):
            name = seen.sighting.name
            counts[name] = counts.get(name, 0) + 1
            if counts[name] <= self.of_a_camera:
                kept.append(seen)
        return kept[::-1]


def _agree(location: Location, limit: float) -> bool:
    """`limit`: of the misfit of one camera's sightings."""
    return location.misfit <= limit if location.agreement is None else location.agreement.agree


def _nearby(sighting: Sighting, track: Track, alone: Location) -> bool:
    """Return whether a track's place is in the direction of a sighting, as far as a wrong camera may be off."""
    position = sighting.pose.position

    def azimuths(location: Location) -> tuple[float, float]:
        """Return the azimuth of the mean place, and the angle that its densest region extends from it."""
        posterior = location.posterior
        off = posterior.places[posterior.densest(0.95)] - position[:2]
        x, y = np.array(posterior.mean) - position[:2]
        middle = math.atan2(x, y)
        turned = (np.arctan2(off[:, 0], off[:, 1]) - middle + np.pi) % (2 * np.pi) - np.pi
        return middle, float(np.abs(turned).max())

    (a, spread_a), (b, spread_b) = azimuths(alone), azimuths(track.location)
    apart = abs((a - b + math.pi) % (2 * math.pi) - math.pi)
    return apart <= math.radians(NEARBY_DEG) + spread_a + spread_b
