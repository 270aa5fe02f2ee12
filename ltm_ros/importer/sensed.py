"""What the sensors of a phone, drone or camera told of one photo, whichever file they wrote it to."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from typing import Literal

from ltm_core.camera_config import PartialCalibration
from ltm_core.types import Float64Array


@dataclass(frozen=True, eq=False)
class Walk:
    """Where a device was carried at eye height: `lon`, `lat` (N,) WGS 84 degrees, and its `climb` (N,) there."""

    lon: Float64Array
    lat: Float64Array
    climb: Float64Array


@dataclass(frozen=True, eq=False)
class Sensed:
    """What is known of one photo, each None where nothing tells it. Angles in degrees, lengths in metres.

    `source`: what told it, for the user. `stamp`: with its zone, exact; None: by EXIF. `altitude`: above sea level, or
    above the WGS 84 ellipsoid where `ellipsoidal`. `climb`: above the place where recording began, by barometer, and
    `walk` where the device was carried on foot. `azimuth_deg`, from true ("T") or magnetic ("M") north, `pitch_deg` and
    `roll_deg` are of the upright image. Sigmas are standard deviations. `calibration`: of the upright image.
    """

    source: str = "EXIF"
    stamp: datetime | None = None
    lon: float | None = None
    lat: float | None = None
    position_sigma: float | None = None
    altitude: float | None = None
    altitude_sigma: float | None = None
    ellipsoidal: bool = False
    climb: float | None = None
    walk: Walk | None = None
    azimuth_deg: float | None = None
    azimuth_ref: Literal["T", "M"] | None = None
    azimuth_sigma_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    tilt_sigma_deg: float | None = None
    calibration: PartialCalibration = field(default_factory=PartialCalibration)
    missing: str = ""
    """Why there is no position, where that is known."""
