"""Read a photo's EXIF: position, time and direction; and the values of its XMP."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import MAXYEAR, UTC, datetime, timedelta
from typing import Any, Literal

from PIL.Image import Exif

from ltm_core.base.errors import ImageError

# Tag numbers: CIPA DC-008 (Exif 2.32), sections 4.6.4 to 4.6.6.
ORIENTATION, EXIF_IFD, _GPS_IFD = 0x0112, 0x8769, 0x8825
_DATES = ((0x9003, 0x9291, 0x9011), (0x9004, 0x9292, 0x9012), (0x0132, 0x9290, 0x9010))
"""Date, fraction of a second and zone: of the exposure, of the digitisation, and of the last change."""
_LATITUDE_REF, _LATITUDE, _LONGITUDE_REF, _LONGITUDE = 1, 2, 3, 4
_ALTITUDE_REF, _ALTITUDE, _GPS_TIME, _DIRECTION_REF, _DIRECTION, _GPS_DATE = 5, 6, 7, 16, 17, 29
_MAP_DATUM, _POSITION_ERROR = 18, 31
_OTHER_DATUM = re.compile("TOKYO|NAD.?27|ED.?50", re.IGNORECASE)
_ROLLOVER = timedelta(weeks=1024)
"""Interval after which a GPS receiver's week number starts again from 0."""
_FIRST_GPS_YEAR = 1999
"""EXIF has GPS tags since 1998; receivers without a fix count from 1980, or from 1970."""
_XMP_VALUE = re.compile(r"""([\w-]+:\w+)\s*=\s*["']([^"']*)["']|<([\w-]+:\w+)>([^<]*)</""")


@dataclass(frozen=True)
class ExifFacts:
    """EXIF of one photo, each value None if missing or invalid.

    `no_position`: reason why a stated position is not used. `altitude`: metres above sea level, negative below (tag 5);
    as most cameras mean sea level even if the standard says ellipsoid (Exif 3.0), it is only certain if `above_sea`.
    `direction_deg`: of the optical axis, clockwise from true ("T") or magnetic ("M") north by `direction_ref`.
    `taken`: by the camera's clock, with its time zone if stated; `changed`: whether it may be the date of an edit.
    `gps_time`: of the GPS fix, UTC. `position_error`: horizontal, metres (tag 31)."""

    orientation: int = 1
    taken: datetime | None = None
    changed: bool = False
    gps_time: datetime | None = None
    lat: float | None = None
    lon: float | None = None
    no_position: str = ""
    altitude: float | None = None
    above_sea: bool = False
    position_error: float | None = None
    direction_deg: float | None = None
    direction_ref: Literal["T", "M"] | None = None


def exif_facts(exif: Exif, what: str) -> ExifFacts:
    """Read the tags; `what` names the photo in errors. Raises ImageError for an invalid latitude or longitude."""
    photo, gps = dict(exif) | exif.get_ifd(EXIF_IFD), exif.get_ifd(_GPS_IFD)
    orientation = exif.get(ORIENTATION, 1)
    lat = _signed(_degrees(gps.get(_LATITUDE)), gps.get(_LATITUDE_REF), "NS")
    lon = _signed(_degrees(gps.get(_LONGITUDE)), gps.get(_LONGITUDE_REF), "EW")
    no_position = ""
    if (lat is not None and abs(lat) > 90) or (lon is not None and abs(lon) > 180):
        raise ImageError(f"{what}: invalid EXIF position lat {lat}, lon {lon}")
    if any(value is not None and math.isnan(value) for value in (lat, lon)):
        no_position = "it does not state the hemisphere (GPSLatitudeRef, GPSLongitudeRef)"
    elif datum := _OTHER_DATUM.search(text_of(gps.get(_MAP_DATUM))):
        no_position = f"it is in the datum {datum[0]}, not in WGS 84"
    if no_position or (lat, lon) == (0.0, 0.0):
        lat = lon = None  # phones write 0, 0 without a GPS fix
    reference = _small_number(gps.get(_ALTITUDE_REF))
    altitude = number(gps.get(_ALTITUDE))
    if altitude is not None and reference in (1, 3):
        altitude = -abs(altitude)
    direction = number(gps.get(_DIRECTION))
    north = text_of(gps.get(_DIRECTION_REF))
    taken, changed = _taken(photo)
    return ExifFacts(
        orientation=orientation if orientation in range(1, 9) else 1,
        taken=taken,
        changed=changed,
        gps_time=_gps_time(gps, taken),
        lat=lat,
        lon=lon,
        no_position=no_position,
        altitude=altitude,
        above_sea=reference in (2, 3),
        position_error=positive(gps.get(_POSITION_ERROR)),
        direction_deg=direction % 360.0 if direction is not None and -180 <= direction <= 360 else None,
        direction_ref="M" if north == "M" else "T" if north == "T" else None,
    )


def xmp_values(xmp: bytes | str | None) -> dict[str, str]:
    """Return the simple values of an XMP packet by their names with prefix, whether attributes or elements."""
    text = xmp.decode("utf-8", "replace") if isinstance(xmp, bytes) else xmp or ""
    found: dict[str, str] = {}
    for attribute, value, element, content in _XMP_VALUE.findall(text):
        found.setdefault(attribute or element, (value or content).strip())
    return found


def _taken(tags: Mapping[int, Any]) -> tuple[datetime | None, bool]:
    """Return the date of the exposure, else of the digitisation, else of the last change, and whether it is the last.

    A zone of the last change counts for another date if both read the same time."""
    *_, (last, _, last_zone) = _DATES
    for tag, fraction_tag, zone_tag in _DATES:
        local = _date_time(text_of(tags.get(tag)))
        if local is None:
            continue
        same = local == _date_time(text_of(tags.get(last)))
        zone = text_of(tags.get(zone_tag)) or (text_of(tags.get(last_zone)) if same or last not in tags else "")
        fraction = text_of(tags.get(fraction_tag))
        if fraction.isascii() and fraction.isdigit():
            local += timedelta(seconds=float(f"0.{fraction}"))
        try:
            zoned = local.replace(tzinfo=datetime.strptime(zone, "%z").tzinfo)
        except ValueError:
            return local, tag == last
        away = zoned.utcoffset() or timedelta()
        return zoned if abs(away) <= timedelta(hours=14) else local, tag == last
    return None, False


def _gps_time(gps: Mapping[int, Any], taken: datetime | None) -> datetime | None:
    """Return the GPS stamp; one that is a multiple of 1024 weeks before the camera's date is moved to it."""
    clock, midnight = gps.get(_GPS_TIME), _date_time(f"{text_of(gps.get(_GPS_DATE))} 00:00:00")
    if midnight is None or midnight.year == MAXYEAR or not (isinstance(clock, tuple) and len(clock) == 3):
        return None
    parts = [number(v) for v in clock]
    if any(v is None or not 0 <= v < most for v, most in zip(parts, (24, 60, 61), strict=True)):
        return None
    hours, minutes, seconds = (part or 0.0 for part in parts)
    stamp = midnight.replace(tzinfo=UTC) + timedelta(hours=hours, minutes=minutes, seconds=seconds)
    if taken is not None:
        apart = (taken if taken.tzinfo is not None else taken.replace(tzinfo=UTC)) - stamp
        turns = round(apart / _ROLLOVER)
        if turns > 0 and abs(apart - turns * _ROLLOVER) < timedelta(days=1):
            stamp += turns * _ROLLOVER
    return stamp if stamp.year >= _FIRST_GPS_YEAR else None


def _date_time(text: str) -> datetime | None:
    try:
        return datetime.strptime(
            re.sub(r"^(\d{4})[-/.:](\d\d)[-/.:](\d\d)[T ]", r"\1:\2:\3 ", text), "%Y:%m:%d %H:%M:%S"
        )
    except ValueError:
        return None


def text_of(value: Any) -> str:
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    return value.strip("\0 ") if isinstance(value, str) else ""


def number(value: Any) -> float | None:
    """Return a rational or a number; None if it is neither, or a fraction over zero."""
    try:
        found = float(value)
    except (TypeError, ValueError, ArithmeticError):
        return None
    return found if math.isfinite(found) else None


def positive(value: Any) -> float | None:
    found = number(value)
    return found if found is not None and found > 0 else None


def _degrees(value: Any) -> float | None:
    if not isinstance(value, tuple) or len(value) != 3:
        return None
    parts = [number(part) for part in value]
    # Some writers leave minutes or seconds as 0/0 and put the fraction into the degrees.
    minutes, seconds = parts[1] or 0.0, parts[2] or 0.0
    if parts[0] is None or not (0 <= minutes <= 60 and 0 <= seconds <= 60):
        return None
    return math.copysign(abs(parts[0]) + minutes / 60 + seconds / 3600, parts[0])


def _signed(value: float | None, reference: Any, letters: str) -> float | None:
    """Return degrees with the sign of the reference, one of two letters; NaN if they do not state the hemisphere."""
    letter = text_of(reference).upper()[:1]
    if not value:
        return value
    if letter == letters[1]:
        return -abs(value)
    return value if value > 0 and letter == letters[0] else math.nan


def _small_number(value: Any) -> int:
    """Return a tag of type BYTE, which some writers store as text."""
    if isinstance(value, str):
        value = value.encode("latin-1", "replace")
    if isinstance(value, bytes):
        value = value[0] % ord("0") if value else 0
    return value if isinstance(value, int) else 0
