"""Where a camera looks, as its PTZ head tells it: what a source asks before and after each picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose


@dataclass(frozen=True)
class PtzReading:
    """What the encoders of a PTZ head said. Signs and zeros are the adapter's; `PoseModel` knows them."""

    pan_deg: float
    tilt_deg: float
    zoom: float
    """In the camera's own measure, such as 1 to 9999 of VAPIX."""
    moving: bool | None
    """Whether the PTZ head says that it moves; None: it does not say."""
    at: float
    """When it was said: seconds of `time.monotonic`."""


class Direction(Protocol):
    """Reads a PTZ head's encoders, over the network: may block for as long as its time limit."""

    def read(self) -> PtzReading:
        """Raises `SourceError` (`ltm_ros.cameras.protocols.credentials`) where the camera does not tell."""
        ...

    def close(self) -> None:
        """End the connection; `read` makes a new one."""
        ...


class Patrol(Protocol):
    """Drives a PTZ head from preset to preset."""

    def advance(self) -> None:
        """Go to the next preset, and come back when the PTZ head rests there. Raises SourceError; StuckPtzError where
        it does not come there."""
        ...


class PoseModel(Protocol):
    """Makes a camera's pose of what its PTZ head says."""

    def pose(self, reading: PtzReading) -> tuple[Pose, Float64Array]:
        """The pose of the optical frame in `map`, and its (6, 6) covariance: position in metres, then rotation about
        the map's axes in radians."""
        ...


@dataclass(frozen=True)
class Tolerance:
    """By how much two readings of a PTZ head at rest may differ."""

    angle_deg: float = 0.05
    """Of pan, and of tilt: encoders flicker by their last digit."""
    zoom: float = 1.0


def difference_deg(first: float, second: float) -> float:
    """Between two angles, at most 180."""
    return abs((second - first + 180.0) % 360.0 - 180.0)


def at_rest(before: PtzReading, after: PtzReading, tolerance: Tolerance) -> bool:
    """Whether the PTZ head stood still from one reading to the other, as far as they tell."""
    return not (
        before.moving
        or after.moving
        or difference_deg(before.pan_deg, after.pan_deg) > tolerance.angle_deg
        or difference_deg(before.tilt_deg, after.tilt_deg) > tolerance.angle_deg
        or abs(before.zoom - after.zoom) > tolerance.zoom
    )
