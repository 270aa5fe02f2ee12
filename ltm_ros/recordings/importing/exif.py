"""Read a photo's position, time and direction from EXIF and XMP.

DJI's gimbal angles are of the camera: yaw clockwise from true north, pitch up from the horizon, roll clockwise. Its
`AbsoluteAltitude` is above sea level (above the ellipsoid with RTK), `RelativeAltitude` above the take-off place."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import MAXYEAR, UTC, datetime, timedelta
from typing import Any, Literal

from PIL.Image import Exif

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float64Array

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
_GIMBAL_SIGMA_DEG = 0.5
"""Standard deviation of the pitch and roll of a drone's gimbal in degrees."""
_XMP_VALUE = re.compile(r"""(?<![\w-])([\w-]+:\w+)\s*=\s*["']([^"']*)["']|<([\w-]+:\w+)>([^<]*)</""")


@dataclass(frozen=True, eq=False)
class Sensed:
    """Known values of one photo, each None if unknown. Angles in degrees, lengths in metres.

    `source`: of the values, for the user. `stamp`: exact; None: by EXIF.
    `altitude`: above the WGS 84 ellipsoid if `ellipsoidal`, above sea level if not; None: not stated, probably above
    sea level. `in_flight`: whether a drone took it. `climb`: above the start of the recording, by barometer, and `walk`
    (N, 3), longitude, latitude and climb along the way, if the device was carried on foot. `azimuth_deg`, from true
    ("T") or magnetic ("M") north, `pitch_deg` and `roll_deg` are of the upright image. Sigmas are standard deviations.
    `missing`: reason why there is no position, if known."""

    source: str = "EXIF"
    stamp: datetime | None = None
    lon: float | None = None
    lat: float | None = None
    position_sigma: float | None = None
    altitude: float | None = None
    altitude_sigma: float | None = None
    ellipsoidal: bool | None = None
    in_flight: bool = False
    climb: float | None = None
    walk: Float64Array | None = None
    azimuth_deg: float | None = None
    azimuth_ref: Literal["T", "M"] | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    tilt_sigma_deg: float | None = None
    missing: str = ""

    def over(self, own: "Sensed") -> "Sensed":
        """Return this, completed from another: position with height, direction, and tilt, each as a whole."""
        taken: dict[str, Any] = {}
        for names in _PARTS:
            if getattr(self, names[0]) is None:
                taken |= {name: getattr(own, name) for name in names}
        return replace(self, **taken, stamp=own.stamp or self.stamp)


_PARTS = (
    ("lon", "lat", "position_sigma", "altitude", "altitude_sigma", "ellipsoidal"),
    ("azimuth_deg", "azimuth_ref"),
    ("pitch_deg", "roll_deg", "tilt_sigma_deg"),
)
"""Values that belong together, by the one that shows whether they are known."""


@dataclass(frozen=True)
class ExifFacts:
    """EXIF of one photo, each value None if missing or invalid.

    `taken`: by the camera's clock, with its time zone if stated; `changed`: whether it may be the date of an edit.
    `gps_time`: of the GPS fix, UTC. `sensed`: position and direction; EXIF has no pitch and no roll. Most cameras mean
    altitudes above sea level even if the standard says ellipsoid (Exif 3.0), so that is only certain if stated."""

    orientation: int = 1
    taken: datetime | None = None
    changed: bool = False
    gps_time: datetime | None = None
    sensed: Sensed = field(default_factory=Sensed)


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
    sensed = Sensed(
        lon=lon,
        lat=lat,
        missing=no_position,
        position_sigma=positive(gps.get(_POSITION_ERROR)),
        altitude=altitude,
        ellipsoidal=False if reference in (2, 3) else None,
        azimuth_deg=direction % 360.0 if direction is not None and -180 <= direction <= 360 else None,
        azimuth_ref="M" if north == "M" else "T" if north == "T" else None,
    )
    known = orientation if orientation in range(1, 9) else 1
    return ExifFacts(known, taken, changed, _gps_time(gps, taken), sensed)


def sensed_by_xmp(xmp: Mapping[str, str], by_exif: Sensed) -> Sensed:
    """Return the sensor data of a photo's XMP (`xmp_values`) over its EXIF; unchanged if it is not from DJI."""
    found = {key.removeprefix("drone-dji:"): value for key, value in xmp.items() if key.startswith("drone-dji:")}
    yaw, pitch, roll = (number(found.get(f"Gimbal{axis}Degree")) for axis in ("Yaw", "Pitch", "Roll"))
    if yaw is pitch is roll is None:
        return by_exif
    facts: dict[str, Any] = {"source": "DJI", "in_flight": True, "pitch_deg": pitch, "roll_deg": roll}
    facts["tilt_sigma_deg"] = _GIMBAL_SIGMA_DEG
    if yaw is not None:
        facts |= {"azimuth_deg": yaw % 360.0, "azimuth_ref": "T"}
    lat, lon = number(found.get("GpsLatitude")), number(found.get("GpsLongitude", found.get("GpsLongtitude")))
    if lat is not None and lon is not None and abs(lat) <= 90 and abs(lon) <= 180 and (lat, lon) != (0.0, 0.0):
        facts |= {"lat": lat, "lon": lon}
    east, north, up = (positive(found.get(f"RtkStd{axis}")) for axis in ("Lon", "Lat", "Hgt"))
    if east and north:
        facts |= {"position_sigma": math.hypot(east, north) / math.sqrt(2), "altitude_sigma": up}
    if (altitude := number(found.get("AbsoluteAltitude"))) is not None:
        facts |= {"altitude": altitude, "ellipsoidal": "rtk" in found.get("AltitudeType", "").lower() or None}
    if (climb := number(found.get("RelativeAltitude"))) is not None:
        facts["climb"] = climb
    return replace(by_exif, **facts)


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
