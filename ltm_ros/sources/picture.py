"""A picture as a camera gave it, with what is known of its time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import Protocol

from ltm_core.types import UInt8Array
from ltm_ros.sources.direction import Reading


@dataclass(frozen=True)
class CameraTime:
    """When the picture was taken by the camera's clock: within [`epoch`, `epoch` + `resolution`] seconds."""

    epoch: float
    resolution: float
    told_by: str
    """`exif`, `last-modified`, `sender-report`, `name` or `list`."""


@dataclass(frozen=True)
class Timing:
    """All times but the camera's are seconds of this computer's monotonic clock."""

    arrived: float
    """When its first byte came, or of a stream its last."""
    asked: float | None = None
    """When it was asked for; None: it came by itself."""
    oldest: float = 1.0
    """How long before it was asked for, or before it arrived by itself, it may have been taken."""
    taken: CameraTime | None = None
    answered: CameraTime | None = None
    """The camera's clock while it answered: HTTP `Date`."""
    stream: float | None = None
    """Of a stream: seconds by its own count, which begins anew with each connection."""
    least_delay: float = 0.0
    """From the exposure to the arrival, of the fastest picture of a stream."""
    trusted: bool = False
    """Whether `taken` is of a clock that is as right as ours."""


@dataclass(frozen=True, eq=False)
class Picture:
    timing: Timing
    jpeg: bytes | None = None
    """The camera's own bytes, JPEG or PNG; None: it sent a video, see `rgb`."""
    rgb: UInt8Array | None = None
    """(H, W, 3), of a video."""
    direction: Reading | None = None
    """Where it came with the picture."""


def stated_number(value: object) -> float | None:
    """A number as a camera states one, in text or not; None where it is none, or not finite."""
    try:
        number = float(value)  # type: ignore[arg-type] # what it cannot take, it refuses
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


class Nothing(Enum):
    """What there is instead of a picture."""

    UNCHANGED = auto()
    """The camera says that its picture is the one it gave before."""
    YET = auto()
    """None has come; ask again."""


class PictureReader(Protocol):
    """A connection to one camera; used by one thread."""

    pause: float
    """Seconds from one call of `read` to the next; 0: `read` waits for the camera itself."""

    def read(self) -> Picture | Nothing:
        """Blocks for some seconds at most. Raises SourceError where the connection must be made anew, PictureError
        where it need not."""
        ...

    def close(self) -> None: ...
