"""What the sensors of a phone, drone or camera told of one photo, whichever file they wrote it to."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Literal

from ltm_core.base.types import Float64Array
from ltm_core.cameras.camera_config import PartialCalibration
from ltm_core.geometry.pose import Pose


@dataclass(frozen=True, eq=False)
class Walk:
    """Where a device was carried at eye height: `lon`, `lat` (N,) WGS 84 degrees, and its `climb` (N,) there."""

    lon: Float64Array
    lat: Float64Array
    climb: Float64Array


@dataclass(frozen=True, eq=False)
class Relative:
    """A frame's pose as seen from the first frame of its capture: `rotation` (3, 3) and `translation` (3,) metres take
    this frame's optical coordinates to that one's."""

    rotation: Float64Array
    translation: Float64Array

    def placed(self, first: Pose) -> Pose:
        """Where this frame was, for the place of the first."""
        return Pose(first.to_map(self.translation), first.rotation @ self.rotation)


@dataclass(frozen=True, eq=False)
class Sensed:
    """What is known of one photo, each None where nothing tells it. Angles in degrees, lengths in metres.

    `source`: what told it, for the user. `stamp`: with its zone, exact; None: by EXIF. `altitude`: above sea level, or
    above the WGS 84 ellipsoid where `ellipsoidal`. `climb`: above the place where recording began, by barometer, and
    `walk` where the device was carried on foot. `azimuth_deg`, from true ("T") or magnetic ("M") north, `pitch_deg` and
    `roll_deg` are of the upright image. Sigmas are standard deviations. `calibration`: of the upright image.
    `seconds`: after the capture's begin. `relative`: to the capture's first frame, of which all the rest then is.
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
    seconds: float = 0.0
    relative: Relative | None = None
    missing: str = ""
    """Why there is no position, where that is known."""

    def over(self, own: Sensed) -> Sensed:
        """This, with what it leaves out from another: place with height, direction, and tilt, each as a whole."""
        taken: dict[str, object] = {}
        for names in _PARTS:
            if getattr(self, names[0]) is None:
                taken |= {name: getattr(own, name) for name in names}
        for name in ("stamp", "seconds", "calibration"):
            if getattr(own, name):
                taken[name] = getattr(own, name)
        return replace(self, **taken)  # type: ignore[arg-type]


_PARTS = (
    ("lon", "lat", "position_sigma", "altitude", "altitude_sigma", "ellipsoidal"),
    ("azimuth_deg", "azimuth_ref", "azimuth_sigma_deg"),
    ("pitch_deg", "roll_deg", "tilt_sigma_deg"),
)
"""What is known together, named by what says whether it is."""
