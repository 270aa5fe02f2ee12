"""Estimate when an image was taken, from EXIF, the camera's clock and its offset."""

from collections import deque
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo

from ltm_core.base.errors import ImageError
from ltm_core.storage.image_io import opened_picture
from ltm_ros.cameras.protocols.picture import CameraTime, Timing
from ltm_ros.recordings.importing.exif import exif_facts

DRIFT = 1e-4
"""Maximum relative clock drift; camera crystals are ten times better, even in frost and sun."""
KEPT = 64
"""Number of observations kept for the bounds."""
WINDOW_S = 60.0
"""Seconds in which a stream's fastest image is searched."""
SETTLED = 20
"""Number of images after which the fastest is known; as many are kept of slow streams."""
STEP_S, STEP_AFTER = 0.5, 10
"""Seconds by which as many consecutive images come later than the fastest if the camera's clock was set back."""


class OffsetBounds:
    """A clock offset bounded by observed intervals. Their intersection is narrow, because a clock with whole seconds is
    observed at all phases of its second."""

    def __init__(self) -> None:
        self.seen: deque[tuple[float, float, float]] = deque(maxlen=KEPT)

    def add(self, low: float, high: float, now: float) -> bool:
        """Add the observation that the offset was within [low, high] at `now`. Returns True if it contradicts earlier
        ones: then the clock was set, and they are dropped."""
        known_low, known_high = self.at(now) if self.seen else (low, high)
        contradicts = low > known_high or high < known_low
        if contradicts:
            self.seen.clear()
        self.seen.append((low, high, now))
        return contradicts

    def at(self, now: float) -> tuple[float, float]:
        """Return the interval that contains the offset now."""
        low = max(low - DRIFT * (now - then) for low, _, then in self.seen)
        high = min(high + DRIFT * (now - then) for _, high, then in self.seen)
        # Two clocks that drift faster than assumed can leave an empty interval.
        return (low, high) if low <= high else ((low + high) / 2,) * 2


class FastestArrival:
    """For a stream with millisecond times: running minimum of arrival minus stated time. The fastest image gives the
    offset, apart from its own delay."""

    def __init__(self) -> None:
        self._delays: deque[tuple[float, float]] = deque()
        self.count = 0

    def add(self, stated: float, arrived: float, *, begins: bool = False) -> bool:
        """Add an image. Returns True if recent images are so late that the clock must have been set back; then only
        they count.

        `begins`: whether it is the first image of a connection, which shows this at once."""
        self.count += 1
        self._delays.append((arrived, arrived - stated))
        while len(self._delays) > SETTLED and self._delays[0][0] < arrived - WINDOW_S:
            self._delays.popleft()
        latest = list(self._delays)[-1 if begins else -STEP_AFTER :]
        set_back = len(self._delays) > len(latest) and min(d for _, d in latest) > self.delay() + STEP_S
        if set_back:
            self._delays, self.count = deque(latest), len(latest)
        return set_back

    def delay(self) -> float:
        """Return arrival minus stated time of the fastest image."""
        return min(delay for _, delay in self._delays)


STREAM_UNCERTAINTY_S = 0.05
"""Uncertainty of a stream's times in seconds: the delay of the fastest image is not known better."""
UNKNOWN_DELAY_S = 0.5
"""Seconds by which a stream's first images may be late, before the fastest is known."""
TRUSTED_UNCERTAINTY_S = 0.02
"""Uncertainty in seconds of a clock synchronised by NTP over a local network."""
PLAUSIBLE_S = 5.0
"""Seconds by which an image may be older than `oldest` before its EXIF clock counts as different from the camera's."""


@dataclass(frozen=True)
class Exposure:
    """`at`: seconds of the monotonic clock. `uncertainty`: half width of the 95 % interval in seconds. `by`: source of
    the time."""

    at: float
    uncertainty: float
    by: str


class ExposureClock:
    """The clocks of one camera, learned from its images."""

    def __init__(self) -> None:
        self._answers = OffsetBounds()
        self._own: dict[str, OffsetBounds] = {}
        self._reports = FastestArrival()
        self._stream: FastestArrival | None = None
        self._reported = False
        """Whether this connection's stream has sent a sender report."""
        self._offset: float | None = None
        """Camera's epoch seconds minus monotonic seconds."""
        self.resets = 0
        """Number of times a camera's clock was found to be set."""

    def offset(self, wall_less_monotonic: float) -> float | None:
        """Return the seconds by which the camera's clock is ahead of this computer's; None: unknown."""
        return None if self._offset is None else self._offset - wall_less_monotonic

    def connected(self) -> None:
        """Restart the estimate for a new connection, whose stream counts time from zero."""
        self._stream, self._reported = None, False

    def estimate(self, timing: Timing, wall_less_monotonic: float) -> Exposure:
        """Return the best estimate for one image; call it for each image, in order."""
        taken, arrived = timing.taken, timing.arrived
        if timing.answered is not None and timing.asked is not None:
            self._offset = self._learn(self._answers, timing.answered, timing.asked, arrived)
        if taken is not None and timing.trusted:
            at = taken.epoch + taken.resolution / 2 - wall_less_monotonic
            return Exposure(min(at, arrived), taken.resolution / 2 + TRUSTED_UNCERTAINTY_S, taken.told_by)
        if timing.stream is not None:
            return self._of_stream(timing, timing.stream)
        # Taken between its greatest possible age and its arrival.
        first = (arrived if timing.asked is None else timing.asked) - timing.oldest
        if taken is None:
            return Exposure((first + arrived) / 2, (arrived - first) / 2, "arrival")
        low, high = self._bounds_of(taken, first, arrived).at(arrived)
        latest = min(taken.epoch + taken.resolution - low, arrived)
        earliest = min(taken.epoch - high, latest)
        return Exposure((earliest + latest) / 2, (latest - earliest) / 2, taken.told_by)

    def _of_stream(self, timing: Timing, stream: float) -> Exposure:
        """Use the stream's own time, or the clock of its sender reports if more of these were seen, because it
        continues over connections."""
        if self._stream is None:
            self._stream = FastestArrival()
        self.resets += self._stream.add(stream, timing.arrived)
        stated, fastest, told_by = stream, self._stream, "timestamp"
        if timing.taken is not None:
            self.resets += self._reports.add(timing.taken.epoch, timing.arrived, begins=not self._reported)
            self._reported, told_by = True, timing.taken.told_by
            if self._reports.count >= fastest.count:
                stated, fastest = timing.taken.epoch, self._reports
        at = min(stated + fastest.delay() - timing.least_delay, timing.arrived)
        if timing.taken is not None:
            self._offset = timing.taken.epoch - at
        unknown = UNKNOWN_DELAY_S / fastest.count if fastest.count < SETTLED else 0.0
        return Exposure(at, STREAM_UNCERTAINTY_S + unknown, told_by)

    def _bounds_of(self, taken: CameraTime, first: float, arrived: float) -> OffsetBounds:
        """Return the offset of the clock that stated the time of an image taken in [first, arrived]; it has a
        resolution, such as whole seconds, and is of a camera that answers requests or writes files."""
        own = self._own.setdefault(taken.told_by, OffsetBounds())
        middle = self._learn(own, taken, first, arrived)
        if not self._answers.seen:
            self._offset = middle
            return own
        # Another clock (EXIF in local time, an image from a recorder) differs by hours; an image only seconds old has
        # a correct time.
        low, high = self._answers.at(arrived)
        plausible = taken.epoch - high <= arrived and taken.epoch + taken.resolution - low >= first - PLAUSIBLE_S
        return self._answers if plausible else own

    def _learn(self, bounds: OffsetBounds, stated: CameraTime, first: float, last: float) -> float:
        """Learn that the clock had the stated time at some moment of [first, last]; return the middle of its offset."""
        self.resets += bounds.add(stated.epoch - last, stated.epoch + stated.resolution - first, last)
        return sum(bounds.at(last)) / 2


_HEAD = 64 << 10
"""EXIF is in a JPEG's first segment, at most this many bytes."""


def exif_time(data: bytes, zone: tzinfo = UTC) -> CameraTime | None:
    """Return the EXIF time by the camera's clock; None if there is none. `zone`: for times without a zone."""
    if b"Exif\0\0" not in data[:_HEAD]:
        return None
    try:
        with opened_picture(data, "image") as image:
            taken = exif_facts(image.getexif(), "image").taken
    except ImageError:
        return None
    # Milliseconds if the camera gives a fraction; this says nothing about its accuracy.
    return None if taken is None else CameraTime(epoch_of(taken, zone), 0.001 if taken.microsecond else 1.0, "exif")


def epoch_of(moment: datetime, zone: tzinfo) -> float:
    """Return the epoch seconds of a time; `zone`: of one without a zone."""
    return (moment if moment.tzinfo is not None else moment.replace(tzinfo=zone)).timestamp()
