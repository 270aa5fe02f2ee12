"""Compute when a photo was taken, from EXIF, the camera's clock and its offset."""

from __future__ import annotations

import io
from collections import deque
from dataclasses import dataclass
from datetime import UTC, tzinfo

import PIL.Image

from ltm_core.base.errors import ImageError
from ltm_core.storage.text_io import BROKEN
from ltm_ros.cameras.protocols.picture import CameraTime, Timing
from ltm_ros.recordings.importing.exif import exif_facts

DRIFT = 1e-4
"""By which a clock's rate is off at most: crystals of cameras keep a tenth of that, in frost and sun too."""
KEPT = 64
"""Observations of which bounds are made."""
WINDOW_S = 60.0
"""In which the fastest picture of a stream counts,"""
LEAST = 20
"""and of slow streams so many at least."""
STEP_S = 0.5
"""By which all pictures of a stream come later than the fastest where its clock was set back,"""
STEP_AFTER = 10
"""so many in a row."""


class OffsetBounds:
    """An offset of which each observation says that it lies in an interval: all of them together make it narrow, for a
    clock of whole seconds is asked at all phases of its second."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, float, float]] = deque(maxlen=KEPT)

    @property
    def known(self) -> bool:
        return bool(self._seen)

    def add(self, low: float, high: float, now: float) -> bool:
        """The offset was within [low, high] at `now`. True where that contradicts what was known: the clock was set,
        and all before is forgotten."""
        contradicts = False
        if self._seen:
            known_low, known_high = self.at(now)
            contradicts = low > known_high or high < known_low
        if contradicts:
            self._seen.clear()
        self._seen.append((low, high, now))
        return contradicts

    def at(self, now: float) -> tuple[float, float]:
        """The interval in which it lies now."""
        low = max(low - DRIFT * (now - then) for low, _, then in self._seen)
        high = min(high + DRIFT * (now - then) for _, high, then in self._seen)
        # Two clocks that drift apart more than they may leave nothing between them.
        return (low, high) if low <= high else ((low + high) / 2,) * 2

    def middle(self, now: float) -> float:
        low, high = self.at(now)
        return (low + high) / 2


class FastestArrival:
    """Of a stream with times to the millisecond: the running minimum of arrival less stated time. The fastest picture
    shows the offset, less what it took itself."""

    def __init__(self) -> None:
        self._delays: deque[tuple[float, float]] = deque()
        self.count = 0

    def add(self, stated: float, arrived: float, *, begins: bool = False) -> bool:
        """True where what came lately is so late that the clock must have been set back: only that counts then.

        `begins`: whether it is the first picture of a connection, which alone shows that.
        """
        self.count += 1
        self._delays.append((arrived, arrived - stated))
        while len(self._delays) > LEAST and self._delays[0][0] < arrived - WINDOW_S:
            self._delays.popleft()
        latest = list(self._delays)[-1 if begins else -STEP_AFTER :]
        if len(self._delays) > len(latest) and min(d for _, d in latest) > self._fastest() + STEP_S:
            self._delays = deque(latest)
            self.count = len(latest)
            return True
        return False

    def offset(self) -> float:
        """Without what the fastest picture took."""
        return -self._fastest()

    def _fastest(self) -> float:
        return min(delay for _, delay in self._delays)


STREAM_UNCERTAINTY_S = 0.05
"""Of a stream's times: what the fastest picture took from exposure to arrival is not known better."""
UNKNOWN_DELAY_S = 0.5
"""By which a stream's first pictures may be late: the fastest is not known yet."""
TRUSTED_UNCERTAINTY_S = 0.02
"""Of a clock that NTP keeps over a local network, as ours."""
SETTLED = 20
"""Pictures after which it is."""
PLAUSIBLE_S = 5.0
"""By which a picture may be older than `oldest` says, as its EXIF has it, before that clock is taken for another than
the one that answers."""


@dataclass(frozen=True)
class Exposure:
    """`at`: seconds of the monotonic clock. `uncertainty`: the true time is within it in 95 of 100 cases. `by`: what
    told it."""

    at: float
    uncertainty: float
    by: str


class ExposureClock:
    """The clocks of one camera, learnt over its pictures."""

    def __init__(self) -> None:
        self._answers = OffsetBounds()
        self._own: dict[str, OffsetBounds] = {}
        self._reports = FastestArrival()
        self._stream: FastestArrival | None = None
        self._reported = False
        """Whether this connection's stream has had a sender report."""
        self._offset: float | None = None
        """Camera's epoch seconds less monotonic ones."""
        self.resets = 0
        """How often a camera's clock was found set."""

    def offset(self, wall_less_monotonic: float) -> float | None:
        """By how many seconds the camera's clock is ahead of this computer's; None: not known."""
        return None if self._offset is None else self._offset - wall_less_monotonic

    def connected(self) -> None:
        """A stream begins anew, and with it the count of its times."""
        self._stream, self._reported = None, False

    def estimate(self, timing: Timing, wall_less_monotonic: float) -> Exposure:
        """The best that is known of one picture; call it for each, in order."""
        if timing.answered is not None and timing.asked is not None:
            self._learn(self._answers, timing.answered.epoch, timing.answered.resolution, timing.asked, timing.arrived)
            self._offset = self._answers.middle(timing.arrived)
        if timing.taken is not None and timing.trusted:
            at = timing.taken.epoch + timing.taken.resolution / 2 - wall_less_monotonic
            return Exposure(
                min(at, timing.arrived), timing.taken.resolution / 2 + TRUSTED_UNCERTAINTY_S, timing.taken.told_by
            )
        if timing.stream is not None:
            return self._of_stream(timing, timing.stream)
        return _arrival(timing) if timing.taken is None else self._of_clock(timing, timing.taken)

    def _of_stream(self, timing: Timing, stream: float) -> Exposure:
        """By the stream's own count, or by the clock of its sender reports where more of these were seen: it goes on
        over connections."""
        if self._stream is None:
            self._stream = FastestArrival()
        self.resets += self._stream.add(stream, timing.arrived)
        stated, fastest, told_by = stream, self._stream, "timestamp"
        if timing.taken is not None:
            self.resets += self._reports.add(timing.taken.epoch, timing.arrived, begins=not self._reported)
            self._reported, told_by = True, timing.taken.told_by
            if self._reports.count >= fastest.count:
                stated, fastest = timing.taken.epoch, self._reports
        at = min(stated - fastest.offset() - timing.least_delay, timing.arrived)
        if timing.taken is not None:
            self._offset = timing.taken.epoch - at
        unknown = UNKNOWN_DELAY_S / fastest.count if fastest.count < SETTLED else 0.0
        return Exposure(at, STREAM_UNCERTAINTY_S + unknown, told_by)

    def _of_clock(self, timing: Timing, taken: CameraTime) -> Exposure:
        """A time with a resolution, such as whole seconds, of a camera that answers or drops files."""
        first = (timing.arrived if timing.asked is None else timing.asked) - timing.oldest
        own = self._own.setdefault(taken.told_by, OffsetBounds())
        self._learn(own, taken.epoch, taken.resolution, first, timing.arrived)
        bounds = own
        if self._answers.known:
            # A clock that is not the one that answers (EXIF in local time, a picture that passed a recorder) puts the
            # picture hours away; one that is only some seconds old is what it says.
            low, high = self._answers.at(timing.arrived)
            if taken.epoch - high <= timing.arrived and taken.epoch + taken.resolution - low >= first - PLAUSIBLE_S:
                bounds = self._answers
        else:
            self._offset = own.middle(timing.arrived)
        low, high = bounds.at(timing.arrived)
        latest = min(taken.epoch + taken.resolution - low, timing.arrived)
        earliest = min(taken.epoch - high, latest)
        return Exposure((earliest + latest) / 2, (latest - earliest) / 2, taken.told_by)

    def _learn(self, bounds: OffsetBounds, epoch: float, resolution: float, first: float, last: float) -> None:
        """The clock read [epoch, epoch + resolution] at some moment of [first, last]."""
        if bounds.add(epoch - last, epoch + resolution - first, last):
            self.resets += 1


def _arrival(timing: Timing) -> Exposure:
    """Without any clock of the camera's: at some moment from the oldest that it may be to its arrival."""
    first = (timing.arrived if timing.asked is None else timing.asked) - timing.oldest
    return Exposure((first + timing.arrived) / 2, (timing.arrived - first) / 2, "arrival")


_HEAD = 64 << 10
"""EXIF stands in a JPEG's first segment, which holds no more."""


def exif_time(data: bytes, zone: tzinfo = UTC) -> CameraTime | None:
    """By the camera's clock; None where none is stated. `zone`: of one that states no zone."""
    if b"Exif\0\0" not in data[:_HEAD]:
        return None
    try:
        with PIL.Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as picture:
            taken = exif_facts(picture.getexif(), "picture").taken
    except (ImageError, *BROKEN):
        return None
    if taken is None:
        return None
    moment = taken if taken.tzinfo is not None else taken.replace(tzinfo=zone)
    # Thousandths, where the camera states a fraction; it says nothing of how exact that is.
    return CameraTime(moment.timestamp(), 0.001 if taken.microsecond else 1.0, "exif")
