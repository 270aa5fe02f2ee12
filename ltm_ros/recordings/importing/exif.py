"""Read a photo's EXIF: position, time, direction and lens."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, Literal

from PIL.Image import Exif

from ltm_core.base.errors import ImageError

# Tag numbers: CIPA DC-008 (Exif 2.32), sections 4.6.4 to 4.6.6.
_ORIENTATION, _DATE_TIME = 0x0112, 0x0132
_EXIF_IFD, _GPS_IFD = 0x8769, 0x8825
_DATE_TIME_ORIGINAL, _OFFSET_TIME, _OFFSET_TIME_ORIGINAL, _SUBSEC_TIME_ORIGINAL = 0x9003, 0x9010, 0x9011, 0x9291
_FOCAL_LENGTH, _FOCAL_LENGTH_35MM, _PIXEL_X_DIMENSION = 0x920A, 0xA405, 0xA002
_FOCAL_PLANE_X_RESOLUTION, _FOCAL_PLANE_RESOLUTION_UNIT = 0xA20E, 0xA210
_LATITUDE_REF, _LATITUDE, _LONGITUDE_REF, _LONGITUDE = 1, 2, 3, 4
_ALTITUDE_REF, _ALTITUDE, _GPS_TIME, _DIRECTION_REF, _DIRECTION, _GPS_DATE = 5, 6, 7, 16, 17, 29
_POSITION_ERROR = 31

_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
FULL_FRAME_WIDTH_MM = 36.0


@dataclass(frozen=True)
class ExifFacts:
    """EXIF of one photo, each value None if missing or invalid.

    `altitude`: metres above sea level, negative below (tag 5). `direction_deg`: of the optical axis, clockwise from
    true ("T") or magnetic ("M") north by `direction_ref`. `taken`: by the camera's clock, with its time zone if stated.
    `gps_time`: of the GPS fix, UTC. `position_error`: horizontal, metres (tag 31). `focal_plane_px_per_mm`: sensor
    pixels per millimetre, of an image `original_width` pixels wide.
    """

    orientation: int = 1
    taken: datetime | None = None
    gps_time: datetime | None = None
    lat: float | None = None
    lon: float | None = None
    altitude: float | None = None
    position_error: float | None = None
    direction_deg: float | None = None
    direction_ref: Literal["T", "M"] | None = None
    focal_mm: float | None = None
    focal_35mm: float | None = None
    focal_plane_px_per_mm: float | None = None
    original_width: int | None = None

    def focal_px(self, width: int, height: int, sensor_width_mm: float | None = None) -> float | None:
        """Return the focal length in pixels of the uncropped image of `width` x `height`; None if unknown.

        It uses the focal length and, in this order, the stated sensor width, EXIF's pixels per millimetre, or the 35 mm
        equivalent over the 36 mm long side (only that is rounded to whole millimetres). If EXIF's two values differ by
        more than 10 %, the 35 mm equivalent is used: some cameras state the resolution of a thumbnail.
        """
        long_side = max(width, height)
        if sensor_width_mm is not None and self.focal_mm is not None:
            return self.focal_mm / sensor_width_mm * long_side
        by_35mm = self.focal_35mm / FULL_FRAME_WIDTH_MM * long_side if self.focal_35mm is not None else None
        by_plane = None
        if self.focal_mm is not None and self.focal_plane_px_per_mm is not None:
            scale = long_side / self.original_width if self.original_width else 1.0
            by_plane = self.focal_mm * self.focal_plane_px_per_mm * scale
        if by_plane is None or (by_35mm is not None and abs(by_plane / by_35mm - 1) > 0.1):
            return by_35mm
        return by_plane


def exif_facts(exif: Exif, what: str) -> ExifFacts:
    """Read the tags; `what` names the photo in errors. Raises ImageError for an invalid latitude or longitude."""
    main, photo, gps = dict(exif), exif.get_ifd(_EXIF_IFD), exif.get_ifd(_GPS_IFD)
    orientation = main.get(_ORIENTATION, 1)
    lat = _signed(_degrees(gps.get(_LATITUDE)), gps.get(_LATITUDE_REF), "S")
    lon = _signed(_degrees(gps.get(_LONGITUDE)), gps.get(_LONGITUDE_REF), "W")
    if (lat is not None and abs(lat) > 90) or (lon is not None and abs(lon) > 180):
        raise ImageError(f"{what}: invalid EXIF position lat {lat}, lon {lon}")
    if (lat, lon) == (0.0, 0.0):
        lat = lon = None  # phones write this without a GPS fix
    altitude = _number(gps.get(_ALTITUDE))
    if altitude is not None and _below_sea(gps.get(_ALTITUDE_REF)):
        altitude = -altitude
    direction = _number(gps.get(_DIRECTION))
    reference = _text(gps.get(_DIRECTION_REF))
    unit = photo.get(_FOCAL_PLANE_RESOLUTION_UNIT, 2)
    resolution = _positive(photo.get(_FOCAL_PLANE_X_RESOLUTION))
    original_width = _positive(photo.get(_PIXEL_X_DIMENSION))
    return ExifFacts(
        orientation=orientation if orientation in range(1, 9) else 1,
        taken=_taken(main, photo),
        gps_time=_gps_time(gps),
        lat=lat,
        lon=lon,
        altitude=altitude,
        position_error=_positive(gps.get(_POSITION_ERROR)),
        direction_deg=direction % 360.0 if direction is not None else None,
        direction_ref="M" if reference == "M" else "T" if reference == "T" else None,
        focal_mm=_positive(photo.get(_FOCAL_LENGTH)),
        focal_35mm=_positive(photo.get(_FOCAL_LENGTH_35MM)),
        focal_plane_px_per_mm=resolution / _MM_PER_UNIT[unit] if resolution and unit in _MM_PER_UNIT else None,
        original_width=int(original_width) if original_width else None,
    )


def _taken(main: Mapping[int, Any], photo: Mapping[int, Any]) -> datetime | None:
    local = _date_time(_text(photo.get(_DATE_TIME_ORIGINAL)) or _text(main.get(_DATE_TIME)))
    if local is None:
        return None
    fraction = _text(photo.get(_SUBSEC_TIME_ORIGINAL))
    if fraction.isdigit():
        local += timedelta(seconds=float(f"0.{fraction}"))
    offset = _text(photo.get(_OFFSET_TIME_ORIGINAL)) or _text(photo.get(_OFFSET_TIME))
    try:
        return local.replace(tzinfo=datetime.strptime(offset, "%z").tzinfo)
    except ValueError:
        return local


def _gps_time(gps: Mapping[int, Any]) -> datetime | None:
    clock = gps.get(_GPS_TIME)
    if not (isinstance(clock, tuple) and len(clock) == 3 and all(_number(v) is not None for v in clock)):
        return None
    try:
        midnight = datetime.strptime(_text(gps.get(_GPS_DATE)), "%Y:%m:%d").replace(tzinfo=UTC)
    except ValueError:
        return None
    hours, minutes, seconds = (float(v) for v in clock)
    return midnight + timedelta(hours=hours, minutes=minutes, seconds=seconds)


def _date_time(text: str) -> datetime | None:
    try:
        return datetime.strptime(text, "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return None


def _text(value: Any) -> str:
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    return value.strip("\0 ") if isinstance(value, str) else ""


def _number(value: Any) -> float | None:
    """Return a rational or a number; None if it is neither, or a fraction over zero."""
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None


def _positive(value: Any) -> float | None:
    number = _number(value)
    return number if number is not None and number > 0 else None


def _degrees(value: Any) -> float | None:
    if not isinstance(value, tuple) or len(value) != 3:
        return None
    parts = [_number(part) for part in value]
    if parts[0] is None:
        return None
    # Some writers leave minutes or seconds as 0/0 and put the fraction into the degrees.
    return parts[0] + (parts[1] or 0.0) / 60 + (parts[2] or 0.0) / 3600


def _signed(value: float | None, reference: Any, negative: str) -> float | None:
    return -value if value is not None and _text(reference).upper() == negative else value


def _below_sea(reference: Any) -> bool:
    return reference in (1, b"\x01", "\x01", "1")
