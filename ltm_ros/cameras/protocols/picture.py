"""Hold an image as a camera sent it with the readings of its PTZ head, and detect stuck and dark images."""

import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import Protocol

import cv2
import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.storage.image_io import decode_rgb
from ltm_ros.cameras.protocols.credentials import PictureError


@dataclass(frozen=True)
class PtzReading:
    """A reading of a PTZ head's encoders. Signs and zeros are the adapter's; the mount converts them."""

    pan_deg: float
    tilt_deg: float
    zoom: float
    """Zoom in the camera's own unit, such as 1 to 9999 for VAPIX."""
    moving: bool | None
    """Whether the PTZ head reports motion; None: it does not report it."""
    at: float
    """Time of the reading in seconds of `time.monotonic`."""


class PtzHead(Protocol):
    """Reads a PTZ head's encoders over the network; may block up to its time limit."""

    def read(self) -> PtzReading:
        """Return a reading. Raises SourceError without an answer, UnauthorisedError if the password is rejected."""
        ...

    def close(self) -> None: ...


@dataclass(frozen=True)
class Tolerance:
    """Maximum differences between two readings of a PTZ head at rest."""

    angle_deg: float = 0.05
    """Degrees of pan and tilt: the last digit of encoders flickers."""
    zoom: float = 1.0


def difference_deg(first: float, second: float) -> float:
    """Return the difference of two angles, at most 180."""
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


@dataclass(frozen=True)
class CameraTime:
    """Exposure time by the camera's clock: within [`epoch`, `epoch` + `resolution`] seconds."""

    epoch: float
    resolution: float
    told_by: str
    """`exif`, `last-modified`, `sender-report`, `name` or `list`."""


@dataclass(frozen=True)
class Timing:
    """All times except the camera's are seconds of this computer's monotonic clock."""

    arrived: float
    """Arrival of its first byte, or for a stream of its last byte."""
    asked: float | None = None
    """Time of the request; None: sent without a request."""
    oldest: float = 1.0
    """Maximum age in seconds at the request, or at the arrival without a request."""
    taken: CameraTime | None = None
    answered: CameraTime | None = None
    """The camera's clock while it answered: HTTP `Date`."""
    stream: float | None = None
    """Seconds by a stream's own count, which starts again with each connection."""
    least_delay: float = 0.0
    """Seconds from exposure to arrival of a stream's fastest image."""
    trusted: bool = False
    """Whether `taken` is from a clock as accurate as ours."""


@dataclass(frozen=True, eq=False)
class CameraImage:
    timing: Timing
    jpeg: bytes | None = None
    """The camera's own bytes, JPEG or PNG; None: it sent video, see `rgb`."""
    rgb: UInt8Array | None = None
    """(H, W, 3), for video."""
    direction: PtzReading | None = None
    """Viewing direction, if it came with the image."""


def stated_number(value: object) -> float | None:
    """Return a number from a camera, text or not; None if invalid or not finite."""
    try:
        number = float(value)  # type: ignore[arg-type] # what it cannot take, it refuses
    except (TypeError, ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


class Nothing(Enum):
    """Reason why there is no image."""

    UNCHANGED = auto()
    """The camera reports that its image has not changed."""
    YET = auto()
    """No image yet; try again."""


class CameraReader(Protocol):
    """A connection to one camera, for one thread."""

    pause: float
    """Seconds between calls of `read`; 0: `read` waits for the camera itself."""

    def read(self) -> CameraImage | Nothing:
        """Return an image; may block for a few seconds. Raises SourceError if the connection must be reopened, else
        PictureError."""
        ...

    def close(self) -> None: ...


DARK = 24
"""Grey level below which the image is dark; cameras' black is 16."""
BRIGHT_SHARE = 0.02
"""Share of the pixels that are bright at night, too: lamps, the moon, a caption."""
GREY = 3
"""Difference of colour channels that compression alone causes."""


def thumbnail_of_bytes(data: bytes) -> UInt8Array:
    """Return a thumbnail (H / 8, W / 8, 3) in BGR of a JPEG or PNG, for a JPEG at a tenth of the decoding cost. Raises
    PictureError."""
    try:
        return np.ascontiguousarray(decode_rgb(data, "image", 8)[..., ::-1])
    except ImageError as error:
        raise PictureError(str(error)) from None


def is_night(thumbnail: UInt8Array) -> bool:
    """Return whether the image is dark apart from some lamps, or has no colour (infrared)."""
    brightest = thumbnail.max(axis=2)
    colour = brightest - thumbnail.min(axis=2)
    return bool((brightest > DARK).mean() <= BRIGHT_SHARE or (colour > GREY).mean() <= BRIGHT_SHARE)


SAME_SHARE = 0.99
"""Share of exactly equal thumbnail pixels in a frozen image, whose caption may still change; noise and light change
most pixels between exposures."""
LEAST_CONTRAST = 4.0
"""Standard deviation of grey levels below which (fog, darkness) an unchanged image proves nothing."""
TURNED_DEG = 5.0
"""Degrees of a PTZ turn after which the image must change."""
SAME_BITS = 4
"""Maximum of differing bits (of 64) in the hashes of two images of one view."""


def same_share(first: UInt8Array, second: UInt8Array) -> float:
    """Return the share of exactly equal pixels of two thumbnails; 0 if sizes differ."""
    return float((first == second).all(axis=2).mean()) if first.shape == second.shape else 0.0


class StuckPicture:
    """Compares each image with the first equal one, and after a turn with the one before the turn. The light of a live
    image soon changes.

    Args: after_s: seconds for which the same image may repeat."""

    def __init__(self, after_s: float) -> None:
        self._after_s = after_s
        self._first = np.empty((0, 0, 3), np.uint8)
        self._same_since: float | None = None
        self._turned_from: tuple[BoolArray, PtzReading] | None = None
        self._turns_unseen = 0

    def look(self, thumbnail: UInt8Array, direction: PtzReading | None, now: float) -> None:
        """Take an image, with the PTZ head's `direction` at rest, if any."""
        grey = np.asarray(cv2.cvtColor(thumbnail, cv2.COLOR_BGR2GRAY), np.uint8)
        telling = float(grey.std()) >= LEAST_CONTRAST
        if not telling or same_share(self._first, thumbnail) < SAME_SHARE:
            self._first, self._same_since = thumbnail, now
        if direction is not None and telling:
            self._compare_turn(grey, direction)

    def repeated(self, now: float) -> None:
        """Record that the camera sent the same bytes, or reported no change."""
        if self._same_since is None:
            self._same_since = now

    def said(self, now: float) -> str:
        """Return why the image is stuck; empty: it is not."""
        if self._turns_unseen >= 2:
            return f"the PTZ head reports a turn of {TURNED_DEG:g} deg or more, but the image stays the same"
        if self._same_since is not None and now - self._same_since >= self._after_s:
            return f"the same image for {now - self._same_since:.0f} s"
        return ""

    def _compare_turn(self, grey: UInt8Array, direction: PtzReading) -> None:
        # Whether each of 8 x 8 cells is brighter than its left neighbour (Krawetz's dHash).
        small = cv2.resize(grey, (9, 8), interpolation=cv2.INTER_AREA)
        bits = small[:, 1:] > small[:, :-1]
        former, before = self._turned_from or (bits, direction)
        unseen = np.count_nonzero(former != bits) <= SAME_BITS
        turned = not at_rest(before, direction, Tolerance(TURNED_DEG, math.inf))
        if turned or self._turned_from is None:
            self._turned_from = bits, direction
        if not unseen:
            self._turns_unseen = 0
        elif turned:
            self._turns_unseen += 1
