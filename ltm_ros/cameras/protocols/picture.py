"""Hold an image as a camera sent it, and detect stuck and dark images by its thumbnail."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto
from typing import Protocol

import cv2
import numpy as np

from ltm_core.base.types import UInt8Array
from ltm_ros.cameras.protocols.credentials import PictureError
from ltm_ros.cameras.protocols.direction import PtzReading, difference_deg


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
class CameraImage:
    timing: Timing
    jpeg: bytes | None = None
    """The camera's own bytes, JPEG or PNG; None: it sent a video, see `rgb`."""
    rgb: UInt8Array | None = None
    """(H, W, 3), of a video."""
    direction: PtzReading | None = None
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


class CameraReader(Protocol):
    """A connection to one camera; used by one thread."""

    pause: float
    """Seconds from one call of `read` to the next; 0: `read` waits for the camera itself."""

    def read(self) -> CameraImage | Nothing:
        """Blocks for some seconds at most. Raises SourceError where the connection must be made anew, PictureError
        where it need not."""
        ...

    def close(self) -> None: ...


DARK = 24
"""Grey level below which nothing is seen; cameras' black is 16."""
BRIGHT_SHARE = 0.02
"""Of the pixels, that are brighter at night too: lamps, the moon, a caption."""
GREY = 3
"""Difference of colour channels that compression makes of none."""
HASH_SIZE = 8


def thumbnail_of_bytes(data: bytes) -> UInt8Array:
    """(H / 8, W / 8, 3) BGR of a JPEG or PNG; of a JPEG a tenth of the work that decoding takes. Raises PictureError
    where it cannot be decoded."""
    try:
        small = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_REDUCED_COLOR_8 | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise PictureError(f"picture of {len(data)} bytes cannot be decoded: {error.err}") from None
    if small is None:
        raise PictureError(f"picture of {len(data)} bytes is corrupt: it cannot be decoded")
    return np.asarray(small, np.uint8)


def thumbnail_of_rgb(rgb: UInt8Array) -> UInt8Array:
    """As `thumbnail_of_bytes`, of every eighth pixel."""
    return np.ascontiguousarray(rgb[4::8, 4::8, ::-1]) if min(rgb.shape[:2]) >= 8 else rgb[..., ::-1]


def is_night(thumbnail: UInt8Array) -> bool:
    """Whether all but some lamps is dark, or nothing has a colour, as under infrared light."""
    brightest = thumbnail.max(axis=2)
    if (brightest > DARK).mean() <= BRIGHT_SHARE:
        return True
    colour = brightest - thumbnail.min(axis=2)
    return bool((colour > GREY).mean() <= BRIGHT_SHARE)


def difference_hash(thumbnail: UInt8Array) -> int:
    """64 bits: whether each of 8 x 8 places is brighter than its left neighbour. Pictures that look the same differ in
    few bits (Krawetz's dHash)."""
    grey = cv2.resize(_grey(thumbnail), (HASH_SIZE + 1, HASH_SIZE), interpolation=cv2.INTER_AREA)
    bits = np.packbits(grey[:, 1:] > grey[:, :-1])
    return int.from_bytes(bits.tobytes(), "big")


def same_share(first: UInt8Array, second: UInt8Array) -> float:
    """Of two thumbnails, the share of pixels that are equal to the last digit: between two exposures, noise and light
    change most; 0 where the sizes differ."""
    if first.shape != second.shape:
        return 0.0
    return float((first == second).all(axis=2).mean())


def contrast(thumbnail: UInt8Array) -> float:
    """Standard deviation of grey levels: fog and darkness have next to none."""
    return float(_grey(thumbnail).std())


def _grey(thumbnail: UInt8Array) -> UInt8Array:
    return np.asarray(cv2.cvtColor(thumbnail, cv2.COLOR_BGR2GRAY), np.uint8)


SAME_SHARE = 0.99
"""Of a thumbnail's pixels that are equal to the digit: a caption's clock may run on in a frozen picture."""
LEAST_CONTRAST = 4.0
"""Below it (fog, darkness) a picture that stays the same says nothing."""
TURNED_DEG = 5.0
"""By which a PTZ head has turned for its picture to change."""
SAME_BITS = 4
"""Of 64 of a difference hash, in which two pictures of one view differ at most."""


class StuckPicture:
    """Compares each picture with the first that looked as it does, from which the light of a living one soon departs,
    and after a turn with the one before the turn.

    Args:
        after_s: for how long the same picture may come again.
    """

    def __init__(self, after_s: float) -> None:
        self._after_s = after_s
        self._first: UInt8Array | None = None
        self._same_since: float | None = None
        self._turned_from: tuple[int, PtzReading] | None = None
        self._turns_unseen = 0

    def look(self, thumbnail: UInt8Array, direction: PtzReading | None, now: float) -> None:
        """Take a picture, of a PTZ head at rest in `direction` where it has one."""
        telling = contrast(thumbnail) >= LEAST_CONTRAST
        if self._first is None or not telling or same_share(self._first, thumbnail) < SAME_SHARE:
            self._first, self._same_since = thumbnail, now
        if direction is not None and telling:
            self._compare_turn(difference_hash(thumbnail), direction)

    def repeated(self, now: float) -> None:
        """The camera sent the very bytes of before, or says that nothing has changed."""
        if self._same_since is None:
            self._same_since = now

    def said(self, now: float) -> str:
        """Why it is stuck; empty: it is not."""
        if self._turns_unseen >= 2:
            return f"the PTZ head says that it turned by {TURNED_DEG:g} deg or more, and the picture stays the same"
        if self._same_since is not None and now - self._same_since >= self._after_s:
            return f"the same picture for {now - self._same_since:.0f} s"
        return ""

    def _compare_turn(self, bits: int, direction: PtzReading) -> None:
        if self._turned_from is None:
            self._turned_from = bits, direction
            return
        former, before = self._turned_from
        turn = max(
            difference_deg(before.pan_deg, direction.pan_deg), difference_deg(before.tilt_deg, direction.tilt_deg)
        )
        unseen = (former ^ bits).bit_count() <= SAME_BITS
        if turn < TURNED_DEG:
            if not unseen:
                self._turns_unseen = 0
            return
        self._turned_from = bits, direction
        self._turns_unseen = self._turns_unseen + 1 if unseen else 0
