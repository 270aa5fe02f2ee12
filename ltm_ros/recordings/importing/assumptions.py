"""Define what photos are placed by besides their own metadata: site, lens, time and camera height."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta, tzinfo
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np

from ltm_core.base.errors import ConfigError, PoseError, RecordingError
from ltm_core.cameras.camera_config import PartialPose
from ltm_core.cameras.plausibility import doubt_of_height
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.raster.dem import Dem
from ltm_core.site.sections import CameraConfig
from ltm_core.surface.config import PoseErrorConfig
from ltm_ros.recordings.importing.photo import Photo
from ltm_ros.recordings.importing.sensor_track import Sensed

_CONTRADICTION = timedelta(minutes=10)
"""Maximum difference between the camera's clock and its GPS stamp, which may be some minutes old."""
_ZONES_APART = timedelta(minutes=15)
"""Time zones differ by multiples of this."""
_FIRST_EXIF_YEAR = 1995
"""Year of the first version of EXIF; cameras whose clock was never set state 1970 or 1980."""


def time_zone(name: str) -> ZoneInfo:
    """Return a time zone by its IANA name. Raises ConfigError for an unknown name."""
    try:
        return ZoneInfo(name)
    except (KeyError, ValueError, OSError) as error:
        raise ConfigError(
            f"unknown time zone {name!r}: give one such as Europe/Oslo or America/Los_Angeles (a system without a "
            "time zone database needs `pip install tzdata`)"
        ) from error


def photo_time(photo: Photo, stated: datetime | None, zone: tzinfo | None, notes: list[str]) -> datetime:
    """Return the time of a photo with its zone.

    Sources in this order: `stated` (UTC unless it names a zone); the time of a recording; EXIF's clock with its own
    zone; this clock in `zone`; the GPS stamp, which is UTC; the clock as UTC. `notes` gets assumptions and
    contradictions between clock and GPS stamp. Raises RecordingError without any date."""
    if stated is not None:
        return stated if stated.tzinfo is not None else stated.replace(tzinfo=UTC)
    if photo.sensed.stamp is not None:
        return photo.sensed.stamp
    clock, gps = photo.exif.taken, photo.exif.gps_time
    if photo.exif.changed and clock is not None:
        notes.append(f"EXIF has no date of the exposure: the date of the last change is used, {clock}")
    if clock is not None and clock.year < _FIRST_EXIF_YEAR:
        notes.append(f"EXIF date {clock}: the camera's clock was probably not set; give a `stamp` in a pose file")
    if clock is None:
        if gps is None:
            raise RecordingError(f"{photo.path} has no date: give it a `stamp` (ISO 8601) in the pose file")
        return gps
    if clock.tzinfo is None:
        if zone is None and gps is not None:
            _compare_minutes(clock, gps, notes)
            return gps
        if zone is None:
            notes.append("EXIF's dates have no time zone: UTC is assumed; give --time-zone otherwise")
        elif clock.replace(tzinfo=zone).utcoffset() != clock.replace(tzinfo=zone, fold=1).utcoffset():
            notes.append(
                f"EXIF date {clock.isoformat()} is in the hour of a clock change of {zone}: it may be an hour off"
            )
        clock = clock.replace(tzinfo=zone or UTC)
    if gps is not None and abs(clock - gps) > _CONTRADICTION:
        notes.append(
            f"EXIF date {clock.isoformat()} and the GPS stamp {gps.isoformat()} differ by {_span(clock - gps)}: "
            "the date is used; check the camera's clock and its time zone, or give a `stamp` in a pose file"
        )
    return clock


def _compare_minutes(clock: datetime, gps: datetime, notes: list[str]) -> None:
    """Check the minutes: a clock without a zone may differ from UTC only by a zone's offset."""
    apart = clock.replace(tzinfo=UTC) - gps
    rest = apart - round(apart / _ZONES_APART) * _ZONES_APART
    if abs(apart) > timedelta(hours=14, minutes=10) or abs(rest) > timedelta(minutes=5):
        notes.append(
            f"EXIF date {clock.isoformat()} (no time zone) and the GPS stamp {gps.isoformat()} differ by "
            f"{_span(apart)}, which is not a time zone: the GPS stamp is used; check the camera's clock"
        )


def _span(apart: timedelta) -> str:
    minutes = round(abs(apart).total_seconds() / 60)
    return (
        f"{minutes // 1440} d {minutes % 1440 // 60} h" if minutes >= 1440 else f"{minutes // 60} h {minutes % 60} min"
    )


@dataclass(frozen=True)
class Assumptions:
    """Assumptions for values that neither pose file, site nor sensors give. Angles in degrees, lengths in metres.

    `pitch_deg`: None: reject a photo of unknown pitch, because a wrong one moves everything that it sees; likewise one
    of unknown azimuth. `keep_unknown`: accept both with a covariance that places nothing until the angle is found.
    `geoid_undulation`: height of the geoid above the ellipsoid, subtracted from altitudes (H = h - N) unless these are
    certainly above sea level. `start_height`: of the camera at the start of a barometer's record, in the DEM's
    vertical datum. `focal_35mm`: focal length in 35 mm equivalent.
    Standard deviations: `gps_sigma` of positions that state none, `altitude_sigma` of altitudes that state none,
    `ground_sigma` of heights above the terrain, `climb_sigma` of barometric heights above the start,
    `compass_sigma_deg` of directions that state none (a median error of 5.5 degrees is 8.2 for a normal distribution),
    `tilt_sigma_deg` of an assumed pitch or roll, `attitude_sigma_deg` of one from sensors."""

    pitch_deg: float | None = None
    height_above_ground: float = 2.0
    geoid_undulation: float | None = None
    time_zone: tzinfo | None = None
    gps_sigma: float = 5.0
    altitude_sigma: float = 10.0
    ground_sigma: float = 1.0
    climb_sigma: float = 1.0
    compass_sigma_deg: float = 8.2
    tilt_sigma_deg: float = 3.0
    attitude_sigma_deg: float = 1.0
    keep_unknown: bool = False
    start_height: float | None = None
    focal_35mm: float | None = None


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Where photos are placed: the map frame, its DEM if any (else heights must be known), known cameras by name, and
    the error of poses that state none."""

    frame: SiteFrame
    dem: Dem | None = None
    cameras: Mapping[str, CameraConfig] = field(default_factory=dict)
    pose_error: PoseErrorConfig = field(default_factory=PoseErrorConfig)

    def covers(self, x: float, y: float) -> bool:
        """Return whether a map point is inside the DEM's outline; True without a DEM."""
        if self.dem is None:
            return True
        covered = self.dem.levels[-1].geometry
        row, col = covered.to_grid(x, y)
        return bool(covered.contains(row + 0.5, col + 0.5))


_SUSPECT_HEIGHT = 25.0
_MAYBE_ELLIPSOIDAL = "if all photos have the same error, their altitudes are ellipsoidal: give --geoid-undulation-m"


def height_of(
    photo: Photo,
    known: PartialPose,
    x: float,
    y: float,
    site: Surroundings,
    assumed: Assumptions,
    notes: list[str],
    found: dict[str, float],
) -> float:
    """Return z in the map frame at (x, y); `found` gets the standard deviation from sensors, `notes` the assumptions.

    Raises PoseError below the ground, and without a height."""
    dem = site.dem
    ground = float(dem.elevation_at(x, y)) if dem is not None else math.nan
    if known.z is not None:
        return _stated_height(photo, known.z, ground, notes)
    if known.height_above_ground is None:
        sensed = _climbed(photo.sensed, site, assumed)
        if sensed is None:
            sensed = _altitude(photo.sensed, ground, assumed, notes)
        if sensed is not None:
            z, sigma, what = sensed
            if not z < ground:  # also if the ground is unknown
                found["height_sigma"] = sigma
                return z
            under = f"{what} {z:.1f} m is {ground - z:.1f} m under the terrain"
            _refuse_in_flight(photo.sensed, photo.path, assumed, under)
            notes.append(
                f"{under}: {assumed.height_above_ground:g} m above the terrain is assumed; {_MAYBE_ELLIPSOIDAL}"
            )
        else:
            _refuse_in_flight(photo.sensed, photo.path, assumed, "its altitude is not known")
    above = known.height_above_ground
    if above is None:
        above, found["height_sigma"] = assumed.height_above_ground, assumed.ground_sigma
        if photo.sensed.altitude is None:
            notes.append(f"height is unknown: {above:g} m above the terrain is assumed")
    if math.isnan(ground):
        why = "there is no DEM (give --site)" if dem is None else "it is outside the DEM"
        raise PoseError(
            f"{photo.path} at map ({x:.1f}, {y:.1f}): a height above ground cannot be used, {why}; give its z"
        )
    return ground + above


def _refuse_in_flight(sensed: Sensed, path: Path, assumed: Assumptions, why: str) -> None:
    """Raise PoseError for a drone of unknown height: it is not at eye height above the terrain."""
    if not sensed.in_flight or (sensed.climb is not None and assumed.start_height is not None):
        return
    if sensed.climb is None:
        raise PoseError(f"{path}: {why}: give the drone's z or height_above_ground in a pose file (--poses)")
    raise PoseError(
        f"{path}: {why}, and {sensed.source} only gives {sensed.climb:.1f} m above the take-off place: give its height "
        "in the DEM's vertical datum, --start-height (0 if the drone counts from sea level)"
    )


def _altitude(sensed: Sensed, ground: float, assumed: Assumptions, notes: list[str]) -> tuple[float, float, str] | None:
    """Return the height in the DEM's datum from an altitude, its standard deviation and its name; None without one."""
    if sensed.altitude is None:
        return None
    undulation = assumed.geoid_undulation
    if sensed.ellipsoidal and undulation is None:
        notes.append(
            f"{sensed.source}'s altitudes are above the WGS 84 ellipsoid, and the geoid's height is unknown: "
            f"{assumed.height_above_ground:g} m above the terrain is assumed; give --geoid-undulation-m to use "
            "them"
        )
        return None
    z, what = sensed.altitude, f"{sensed.source} altitude"
    if sensed.ellipsoidal is not False:
        z -= undulation or 0.0
    if z > ground + _SUSPECT_HEIGHT:
        notes.append(f"{what} {z:.1f} m is {z - ground:.1f} m above the terrain: {_MAYBE_ELLIPSOIDAL}")
    return z, sensed.altitude_sigma or assumed.altitude_sigma, what


def _climbed(sensed: Sensed, site: Surroundings, assumed: Assumptions) -> tuple[float, float, str] | None:
    """Return the height from the barometer. Weather moves it by tens of metres, so only the climb since the start is
    used.

    The start height is given by the user, or is the median that puts the whole walk at eye height above the terrain,
    because single GPS fixes may be on other ground."""
    if sensed.climb is None:
        return None
    what = f"{sensed.source} barometer's height"
    if assumed.start_height is not None:
        return assumed.start_height + sensed.climb, assumed.climb_sigma, what
    if sensed.walk is None or site.dem is None:
        return None
    lon, lat, climb = sensed.walk.T
    ground = site.dem.elevation_at(*site.frame.from_lonlat(lon, lat))
    starts = (ground - climb)[np.isfinite(ground)]
    if not len(starts):
        return None
    start = float(np.median(starts)) + assumed.height_above_ground
    return start + sensed.climb, math.hypot(assumed.ground_sigma, assumed.climb_sigma), what


def _stated_height(photo: Photo, z: float, ground: float, notes: list[str]) -> float:
    doubt = doubt_of_height(z, ground)
    if z <= ground:
        raise PoseError(f"{photo.path}: {doubt}")
    if doubt is not None:
        notes.append(doubt)
    return z
