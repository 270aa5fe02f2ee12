"""Assign sightings of several cameras and times to fires, with the pose that each was marked under.

A sighting joins the track that it agrees with best (`Locator.limit`). If it agrees with none but lies in the direction
of one, it begins a track of its own, and its cameras count as disagreeing about it."""

import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ltm_core.base.errors import RegionError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose
from ltm_core.locating.locator import Location, Locator
from ltm_core.locating.sighting import Sighting

MOST = 200  # maximum number of poses kept; the least recently received one is dropped first


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
        last = max((known for known in self._poses if known <= stamp), default=None)
        return None if last is None or stamp - last > age_ns else self._poses[last]


NEARBY_DEG = 4.0  # maximum angle between a sighting and a track for both to be one fire if a camera is wrong


@dataclass(frozen=True, eq=False)
class SeenAt:
    """Sighting with its time and its origin, `detector` or `person`."""

    sighting: Sighting
    stamp_ns: int
    source: str


@dataclass(eq=False)
class Track:
    """Track of one fire. `sightings`: newest last. `disputed`: cameras that disagree about it."""

    number: int
    sightings: list[SeenAt]
    location: Location
    disputed: frozenset[str] = frozenset()

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
    """The tracks of a site. `smoke`: smoke is marked. `lifetime_ns`: after which a track without a new sighting ends.
    `most`: maximum number of tracks, the most recently seen. `of_a_camera`: maximum number of sightings of one camera
    in a track, the newest."""

    locator: Locator
    smoke: bool = True
    lifetime_ns: int = 3_600_000_000_000
    most: int = 16
    of_a_camera: int = 2
    tracks: list[Track] = field(default_factory=list)
    _next: int = 1

    def add(self, seen: SeenAt) -> tuple[Track, Location]:
        """Add a sighting. Return its track and its own location. Raises as `Locator.locate`; nothing changes then."""
        alone = self.locator.locate([seen.sighting], self.smoke)
        self.tracks = [track for track in self.tracks if seen.stamp_ns - track.last_ns <= self.lifetime_ns]
        best: tuple[float, Track, Location] | None = None
        disputes: list[tuple[Track, frozenset[str]]] = []
        for track in self.tracks:
            if not _nearby(seen.sighting, track, alone):
                continue
            together = self._kept([*track.sightings, seen])
            try:
                location = self.locator.locate([each.sighting for each in together], self.smoke)
            except RegionError:
                continue
            agreement = location.agreement
            if location.misfit <= self.locator.limit if agreement is None else agreement.agree:
                if best is None or location.misfit < best[0]:
                    best = (location.misfit, track, location)
            elif agreement is not None:
                disputes.append((track, frozenset(agreement.suspicion)))
        if best is not None:
            _, track, location = best
            track.sightings, track.location = self._kept([*track.sightings, seen]), location
            return track, alone
        track = Track(self._next, [seen], alone)
        if disputes:
            other, cameras = max(disputes, key=lambda each: len(each[0].cameras))
            track.disputed = other.disputed = cameras
        self._next += 1
        self.tracks = sorted([*self.tracks, track], key=lambda each: each.last_ns)[-self.most :]
        return track, alone

    def _kept(self, sightings: Sequence[SeenAt]) -> list[SeenAt]:
        """Return the newest of each camera."""
        kept: list[SeenAt] = []
        for seen in sorted(sightings, key=lambda each: each.stamp_ns)[::-1]:  # of equal stamps, the last one first
            if sum(other.sighting.name == seen.sighting.name for other in kept) < self.of_a_camera:
                kept.append(seen)
        return kept[::-1]


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
