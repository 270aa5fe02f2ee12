"""Define what photos are placed by besides their own metadata: site, lens, time and camera height."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta, tzinfo
from zoneinfo import ZoneInfo

from ltm_core.base.errors import ConfigError, RecordingError
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.raster.dem import Dem
from ltm_core.site.sections import CameraConfig
from ltm_core.surface.config import PoseErrorConfig
from ltm_ros.recordings.importing.photo import Photo

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
            f"unknown time zone {name!r}: give one such as Europe/Oslo (or pip install tzdata)"
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
    if clock is None:
        if gps is None:
            raise RecordingError(f"{photo.path} has no date: give it a `stamp` (ISO 8601) in the pose file")
        return gps
    said = f"EXIF date {clock.isoformat()}"
    if photo.exif.changed:
        notes.append(f"{said} is that of the last change, because there is none of the exposure")
    if clock.year < _FIRST_EXIF_YEAR:
        notes.append(f"{said}: the camera's clock was probably not set; give a `stamp` in a pose file")
    if clock.tzinfo is None and zone is None and gps is not None:
        apart = clock.replace(tzinfo=UTC) - gps  # a clock without a zone may differ from UTC only by a zone's offset
        rest = apart - round(apart / _ZONES_APART) * _ZONES_APART
        if abs(apart) > timedelta(hours=14, minutes=10) or abs(rest) > timedelta(minutes=5):
            off = f"{said} (no time zone) and the GPS stamp {gps.isoformat()} differ by {_span(apart)}"
            notes.append(f"{off}, which is not a time zone: the GPS stamp is used; check the camera's clock")
        return gps
    if clock.tzinfo is None and zone is None:
        notes.append("EXIF's dates have no time zone: UTC is assumed; give --time-zone otherwise")
    elif clock.tzinfo is None:
        first, second = (clock.replace(tzinfo=zone, fold=fold).utcoffset() for fold in (0, 1))
        if first != second:
            notes.append(f"{said} is in the hour of a clock change of {zone}: it may be an hour off")
    clock = clock if clock.tzinfo is not None else clock.replace(tzinfo=zone or UTC)
    if gps is not None and abs(clock - gps) > _CONTRADICTION:
        off = f"{said} and the GPS stamp {gps.isoformat()} differ by {_span(clock - gps)}"
        notes.append(f"{off}: the date is used; check the camera's clock and its time zone, or give a `stamp`")
    return clock


def _span(apart: timedelta) -> str:
    days, minutes = divmod(round(abs(apart).total_seconds() / 60), 1440)
    return f"{days} d {minutes // 60} h" if days else f"{minutes // 60} h {minutes % 60} min"


@dataclass(frozen=True)
class Assumptions:
    """Assumptions for values that neither pose file, site nor sensors give. Angles in degrees, lengths in metres.

    `pitch_deg`: None: reject a photo of unknown pitch, because a wrong one moves everything that it sees; likewise one
    of unknown azimuth. `keep_unknown`: accept both with a covariance that places nothing until the angle is found.
    `geoid_undulation`: height of the geoid above the ellipsoid, subtracted from altitudes (H = h - N) unless these are
    certainly above sea level. `start_height`: of the camera at the start of a barometer's record, in the DEM's
    vertical datum. `focal_35mm`: focal length in 35 mm equivalent."""

    pitch_deg: float | None = None
    height_above_ground: float = 2.0
    geoid_undulation: float | None = None
    time_zone: tzinfo | None = None
    keep_unknown: bool = False
    start_height: float | None = None
    focal_35mm: float | None = None


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Map frame, its DEM if any, known cameras by name, and the error of poses that state none."""

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
