"""What all heads can be asked, whatever they speak."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from ltm_core.ptz_config import IsapiConfig, OnvifConfig, PtzConfig, ReolinkConfig, VapixConfig
from ltm_ros.sources.direction import Reading, Tolerance
from ltm_ros.sources.errors import SourceError


@dataclass(frozen=True)
class Limits:
    """How far a head goes, degrees and the camera's own zoom; None: it does not say."""

    pan_deg: tuple[float, float] | None = None
    tilt_deg: tuple[float, float] | None = None
    zoom: tuple[float, float] | None = None


class Head(Protocol):
    """A `Direction` that knows more. All but `go_to` only asks.

    Everything raises SourceError where the head does not tell, and UnauthorisedError where it refuses the password.
    """

    spacing: float
    """Seconds between two readings that show a head which turns by 1 deg/s."""

    def read(self) -> Reading: ...

    def limits(self) -> Limits: ...

    def presets(self) -> Mapping[str, str]:
        """What the head calls each preset, by its name."""
        ...

    def go_to(self, preset: str) -> None:
        """Drive to a preset, by its name; returns before it is there. Raises SourceError for a name that it does not
        have."""
        ...

    def close(self) -> None: ...


def token_of(presets: Mapping[str, str], preset: str) -> str:
    """What the head calls a preset. Raises SourceError naming those there are."""
    if preset not in presets:
        raise SourceError(f"the head has no preset {preset!r}; it has {', '.join(presets) or 'none'}")
    return presets[preset]


def tolerance_of(config: PtzConfig) -> Tolerance:
    """By which two readings of a head at rest differ: some of its last digit."""
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
"""A head that turns as fast as this is told from one at rest."""


def spacing_for(tolerance_deg: float) -> float:
    """Twice the tolerance, so that a flicker of the last digit hides nothing."""
    return 2 * tolerance_deg / SLOWEST_DEG_S
