"""Query PTZ heads of all makers for their direction, at readings close enough to notice motion."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from ltm_core.site.source_config import IsapiConfig, OnvifConfig, PatrolConfig, PtzConfig, ReolinkConfig, VapixConfig
from ltm_ros.cameras.protocols.credentials import SourceError, StuckPtzError
from ltm_ros.cameras.protocols.direction import PtzReading, Tolerance, at_rest


@dataclass(frozen=True)
class PtzLimits:
    """How far a PTZ head goes, degrees and the camera's own zoom; None: it does not say."""

    pan_deg: tuple[float, float] | None = None
    tilt_deg: tuple[float, float] | None = None
    zoom: tuple[float, float] | None = None


class PtzHead(Protocol):
    """A `Direction` that knows more. All but `go_to` only asks.

    Everything raises SourceError where the PTZ head does not tell, and UnauthorisedError where it refuses the password.
    """

    spacing: float
    """Seconds between two readings that show a PTZ head which turns by 1 deg/s."""

    def read(self) -> PtzReading: ...

    def limits(self) -> PtzLimits: ...

    def presets(self) -> Mapping[str, str]:
        """What the PTZ head calls each preset, by its name."""
        ...

    def go_to(self, preset: str) -> None:
        """Drive to a preset, by its name; returns before it is there. Raises SourceError for a name that it does not
        have."""
        ...

    def close(self) -> None: ...


def token_of(presets: Mapping[str, str], preset: str) -> str:
    """What the PTZ head calls a preset. Raises SourceError naming those there are."""
    if preset not in presets:
        raise SourceError(f"the PTZ head has no preset {preset!r}; it has {', '.join(presets) or 'none'}")
    return presets[preset]


def tolerance_of(config: PtzConfig) -> Tolerance:
    """By which two readings of a PTZ head at rest differ: some of its last digit."""
    match config:
        case VapixConfig():
            return Tolerance(config.tolerance_deg or 0.05, 1.0)
        case IsapiConfig():
            usual, zoom = (0.15, 1.0) if config.units == "tenths" else (0.05, 0.1)
            return Tolerance(config.tolerance_deg or usual, zoom)
        case OnvifConfig():
            return Tolerance(config.tolerance_deg or 0.05, 0.002)
        case ReolinkConfig():
            return Tolerance(config.tolerance_deg or 0.15, 1.0)


SLOWEST_DEG_S = 1.0
"""A PTZ head that turns as fast as this is told from one at rest."""


def spacing_for(tolerance_deg: float) -> float:
    """Twice the tolerance, so that a flicker of the last digit hides nothing."""
    return 2 * tolerance_deg / SLOWEST_DEG_S


STARTS_WITHIN_S = 2.0
"""In which a PTZ head that is sent elsewhere begins to move."""
SAME_PRESET_DEG = 0.5
"""By which a PTZ head may come back to a preset elsewhere before that is told."""


class PtzDirection:
    """For one thread.

    Args:
        open_head: raises SourceError, UnauthorisedError.
        sleep: instead of `time.sleep`, and `now` instead of `time.monotonic`, in tests.
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
        """Waits until a PTZ head that turns slowly would read otherwise than before; fractions of a second."""
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
    """One controller: what it reads between its own commands must be what these ask for."""

    def __init__(self, direction: PtzDirection, config: PatrolConfig, tolerance: Tolerance) -> None:
        self._direction, self._config, self._tolerance = direction, config, tolerance
        self._next = 0
        self._at: str | None = None
        self._places: dict[str, PtzReading] = {}
        """Where each preset was when the PTZ head was there first."""

    def advance(self) -> None:
        """To the next preset, settled. Raises StuckPtzError where the PTZ head does not go or does not stop,
        SourceError where it does not tell, or where something else has driven it away."""
        preset = self._config.presets[self._next]
        before = self._direction.read()
        self._direction.ptz().go_to(preset)
        reading = self._arrived(preset, before)
        self._check(preset, before, reading)
        self._places.setdefault(preset, reading)
        self._at = preset
        self._next = (self._next + 1) % len(self._config.presets)

    def _arrived(self, preset: str, before: PtzReading) -> PtzReading:
        """Two equal readings after it has begun to move, and again two when it has settled."""
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
                    f"the PTZ head was sent to preset {preset!r} and has not come to rest within "
                    f"{self._config.arrive_within:g} s; it reads pan {reading.pan_deg:.2f}, tilt {reading.tilt_deg:.2f}"
                )
            last = reading

    def _check(self, preset: str, before: PtzReading, reading: PtzReading) -> None:
        known = self._places.get(preset)
        if known is not None and not at_rest(known, reading, Tolerance(SAME_PRESET_DEG, self._tolerance.zoom * 10)):
            if self._same(before, reading):
                raise StuckPtzError(
                    f"the PTZ head was sent to preset {preset!r} (pan {known.pan_deg:.2f}, tilt {known.tilt_deg:.2f}) "
                    f"and stays at pan {reading.pan_deg:.2f}, tilt {reading.tilt_deg:.2f}: it is stuck, or something "
                    "else drives it"
                )
            self._places[preset], self._at = reading, preset
            raise SourceError(
                f"preset {preset!r} was at pan {known.pan_deg:.2f}, tilt {known.tilt_deg:.2f}, and is now at pan "
                f"{reading.pan_deg:.2f}, tilt {reading.tilt_deg:.2f}: it was changed, or something else "
                "drives the PTZ head"
            )
        other = self._at is not None and self._at != preset
        if known is None and other and self._same(before, reading):
            raise StuckPtzError(
                f"the PTZ head was sent from preset {self._at!r} to {preset!r} and reads the same direction, pan "
                f"{reading.pan_deg:.2f}, tilt {reading.tilt_deg:.2f}: it is stuck"
            )

    def _same(self, first: PtzReading, second: PtzReading) -> bool:
        return at_rest(first, second, self._tolerance)
