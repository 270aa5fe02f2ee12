"""Define readings of PTZ heads, which a source requests before and after each image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose


@dataclass(frozen=True)
class PtzReading:
    """A reading of a PTZ head's encoders. Signs and zeros are the adapter's; `PoseModel` converts them."""

    pan_deg: float
    tilt_deg: float
    zoom: float
    """Zoom in the camera's own unit, such as 1 to 9999 for VAPIX."""
    moving: bool | None
    """Whether the PTZ head reports motion; None: it does not report it."""
    at: float
    """Time of the reading in seconds of `time.monotonic`."""


class Direction(Protocol):
    """Reads a PTZ head's encoders over the network; may block up to its time limit."""

    def read(self) -> PtzReading:
        """Return a reading. Raises `SourceError` (`ltm_ros.cameras.protocols.credentials`) without an answer."""
        ...

    def close(self) -> None:
        """Close the connection; `read` opens a new one."""
        ...


class Patrol(Protocol):
    """Moves a PTZ head from preset to preset."""

    def advance(self) -> None:
        """Go to the next preset and wait until it rests there. Raises SourceError; StuckPtzError if it does
        not arrive.
        """
        ...


class PoseModel(Protocol):
    """Computes a camera's pose from readings of its PTZ head."""

    def pose(self, reading: PtzReading) -> tuple[Pose, Float64Array]:
        """Return the pose of the optical frame in `map`, and its (6, 6) covariance: position in metres, then rotation
        about the map's axes in radians.
        """
        ...


@dataclass(frozen=True)
class Tolerance:
    """Maximum differences between two readings of a PTZ head at rest."""

    angle_deg: float = 0.05
    """Degrees of pan and tilt: the last digit of encoders flickers."""
    zoom: float = 1.0


def difference_deg(first: float, second: float) -> float:
    """Between two angles, at most 180."""
    return abs((second - first + 180.0) % 360.0 - 180.0)


def at_rest(before: PtzReading, after: PtzReading, tolerance: Tolerance) -> bool:
    """Return whether the PTZ head was at rest between two readings, as far as they show it."""
    return not (
        before.moving
        or after.moving
        or difference_deg(before.pan_deg, after.pan_deg) > tolerance.angle_deg
        or difference_deg(before.tilt_deg, after.tilt_deg) > tolerance.angle_deg
        or abs(before.zoom - after.zoom) > tolerance.zoom
    )
