"""Read the directions of PTZ heads of all makers, with readings close enough to detect motion."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from ltm_core.site.source_config import IsapiConfig, OnvifConfig, PatrolConfig, PtzConfig, VapixConfig
from ltm_ros.cameras.protocols.credentials import SourceError, StuckPtzError
from ltm_ros.cameras.protocols.picture import PtzReading, Tolerance, at_rest


@dataclass(frozen=True)
class PtzLimits:
    """Limits of a PTZ head in degrees and the camera's zoom unit; None: not reported."""

    pan_deg: tuple[float, float] | None = None
    tilt_deg: tuple[float, float] | None = None
    zoom: tuple[float, float] | None = None


class PtzHead(Protocol):
    """A `Direction` with limits and presets. Only `go_to` moves the head.

    Every method raises SourceError without an answer, and UnauthorisedError if the password is rejected.
    """

    spacing: float
    """Seconds between two readings that detect a rotation of 1 deg/s."""

    def read(self) -> PtzReading: ...

    def limits(self) -> PtzLimits: ...

    def presets(self) -> Mapping[str, str]:
        """Return the PTZ head's tokens of its presets, by name."""
        ...

    def go_to(self, preset: str) -> None:
        """Start moving to a preset and return at once. Raises SourceError for an unknown name."""
        ...

    def close(self) -> None: ...


def token_of(presets: Mapping[str, str], preset: str) -> str:
    """Return the token of a preset. Raises SourceError that lists the presets."""
    if preset not in presets:
        raise SourceError(f"the PTZ head has no preset {preset!r}; it has {', '.join(presets) or 'none'}")
    return presets[preset]


def tolerance_of(config: PtzConfig) -> Tolerance:
    """Return the difference of two readings at rest: a few units of the last digit."""
    match config:
        case VapixConfig():
            return Tolerance(config.tolerance_deg or 0.05, 1.0)
        case IsapiConfig():
            usual, zoom = (0.15, 1.0) if config.units == "tenths" else (0.05, 0.1)
            return Tolerance(config.tolerance_deg or usual, zoom)
        case OnvifConfig():
            return Tolerance(config.tolerance_deg or 0.05, 0.002)


SLOWEST_DEG_S = 1.0
"""Slowest rotation in deg/s that is distinguished from rest."""


def spacing_for(tolerance_deg: float) -> float:
    """Return the spacing for twice the tolerance, so that flicker of the last digit hides no motion."""
    return 2 * tolerance_deg / SLOWEST_DEG_S


STARTS_WITHIN_S = 2.0
"""Seconds within which a PTZ head starts to move after a command."""
SAME_PRESET_DEG = 0.5
"""Degrees by which a PTZ head may miss a preset before this is reported."""


class PtzDirection:
    """Reads a PTZ head; for one thread.

    Args: open_head: raises SourceError, UnauthorisedError. sleep, now: replace `time.sleep` and `time.monotonic` in
    tests.
    """

    def __init__(
        self,
        open_ptz: Callable[[], PtzHead],
        sleep: Callable[[float], None] = time.sleep,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._open, self._sleep, self._now = open_ptz, sleep, now
        self._ptz: PtzHead | None = None
        self._last: PtzReading | None = None

    def read(self) -> PtzReading:
        """Return a reading after waiting long enough to detect a slow rotation; fractions of a second."""
        ptz = self.ptz()
        if self._last is not None:
            self._sleep(max(0.0, self._last.at + ptz.spacing - self._now()))
        self._last = ptz.read()
        return self._last

    def ptz(self) -> PtzHead:
        if self._ptz is None:
            self._ptz = self._open()
        return self._ptz

    @property
    def now(self) -> float:
        return self._now()

    def close(self) -> None:
        ptz, self._ptz = self._ptz, None
        self._last = None
        if ptz is not None:
            ptz.close()


class PtzPatrol:
    """Moves a PTZ head as its only controller: readings between its commands must match them."""

    def __init__(self, direction: PtzDirection, config: PatrolConfig, tolerance: Tolerance) -> None:
        self._direction, self._config, self._tolerance = direction, config, tolerance
        self._next = 0
        self._at: str | None = None
        self._places: dict[str, PtzReading] = {}
        """Position of each preset at the first visit."""

    def advance(self) -> None:
        """Go to the next preset and wait until it rests. Raises StuckPtzError if the head does not move or does not
        stop, SourceError without an answer or if another controller has moved it.
        """
        preset = self._config.presets[self._next]
        before = self._direction.read()
        self._direction.ptz().go_to(preset)
        reading = self._arrived(preset, before)
        self._check(preset, before, reading)
        self._places.setdefault(preset, reading)
        self._at = preset
        self._next = (self._next + 1) % len(self._config.presets)

    def _arrived(self, preset: str, before: PtzReading) -> PtzReading:
        """Wait for two equal readings after the start of the motion, and two more after settling."""
        begun = self._direction.now
        until = begun + self._config.arrive_within
        known = self._places.get(preset)
        started = known is not None and self._same(before, known)
        last = before
        rested_since: float | None = None
        while True:
            reading = self._direction.read()
            still = self._same(last, reading)
            started = started or not self._same(before, reading) or reading.at - begun > STARTS_WITHIN_S
            if not (started and still):
                rested_since = None
            elif rested_since is None:
                rested_since = reading.at
            elif reading.at - rested_since >= self._config.settle:
                return reading
            if self._direction.now > until:
                raise StuckPtzError(
                    f"sent to preset {preset!r}, the PTZ head did not come to rest within "
                    f"{self._config.arrive_within:g} s; it reads pan {reading.pan_deg:.2f}, tilt "
                    f"{reading.tilt_deg:.2f}"
                )
            last = reading

    def _check(self, preset: str, before: PtzReading, reading: PtzReading) -> None:
        known = self._places.get(preset)
        if known is not None and not at_rest(known, reading, Tolerance(SAME_PRESET_DEG, self._tolerance.zoom * 10)):
            if self._same(before, reading):
                raise StuckPtzError(
                    f"sent to preset {preset!r} (pan {known.pan_deg:.2f}, tilt {known.tilt_deg:.2f}), the PTZ "
                    f"head stays at pan {reading.pan_deg:.2f}, tilt {reading.tilt_deg:.2f}: it is stuck, or "
                    "another program moves it"
                )
            self._places[preset], self._at = reading, preset
            raise SourceError(
                f"preset {preset!r} was at pan {known.pan_deg:.2f}, tilt {known.tilt_deg:.2f}, and is now at pan "
                f"{reading.pan_deg:.2f}, tilt {reading.tilt_deg:.2f}: it was changed, or another program moves "
                "the PTZ head"
            )
        other = self._at is not None and self._at != preset
        if known is None and other and self._same(before, reading):
            raise StuckPtzError(
                f"sent from preset {self._at!r} to {preset!r}, the PTZ head reads the same direction, pan "
                f"{reading.pan_deg:.2f}, tilt {reading.tilt_deg:.2f}: it is stuck"
            )

    def _same(self, first: PtzReading, second: PtzReading) -> bool:
        return at_rest(first, second, self._tolerance)
