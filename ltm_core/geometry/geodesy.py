"""Convert geographic coordinates to the site's map frame and back; compute the sun's elevation.

Conversions between geographic coordinates and the site's map frame, of north references and of height systems.

Compass north, true north and grid north are three things; this is the one place that converts between them. Heights are
ellipsoidal or orthometric.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import date
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS, Proj, Transformer
from pyproj.exceptions import CRSError

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import Float64Array

EARTH_RADIUS = 6_371_008.8
"""Mean radius of the WGS 84 ellipsoid in metres (IUGG R1)."""


def ray_bend(curvature: bool, refraction: float) -> float:
    """Return the coefficient c of a ray's height z(r) = z0 + s r + c r^2 over horizontal range r, 1/metres.

    The earth falls away by r^2 / 2R and standard air bends light by the share `refraction` (k) of that back down:
    c = (1 - k) / (2 R). Zero on a flat earth. Source: surveying's combined correction, e.g. Torge, Geodesy, 5.1.
    """
    if not 0 <= refraction < 1:
        raise ConfigError(f"refraction coefficient must lie in [0, 1), standard air is 0.13; got {refraction}")
    return (1 - refraction) / (2 * EARTH_RADIUS) if curvature else 0.0


@dataclass(frozen=True)
class SiteFrame:
    """The map frame of a site: a projected CRS in metres minus an origin; z stays orthometric.

    With an origin near the site, float32 coordinates keep millimetres. Raises ConfigError where the CRS is unknown,
    geographic, or not in metres.
    """

    crs: str
    x_origin: float = 0.0
    y_origin: float = 0.0

    def __post_init__(self) -> None:
        try:
            crs = CRS.from_user_input(self.crs)
        except CRSError as error:
            raise ConfigError(f"unknown CRS {self.crs!r}: give an EPSG code such as EPSG:32611 ({error})") from error
        if not crs.is_projected or {axis.unit_name for axis in crs.axis_info[:2]} != {"metre"}:
            raise ConfigError(
                f"a site needs a projected CRS in metres, such as its UTM zone; {self.crs!r} is {crs.name}"
            )

    def from_lonlat(self, lon: ArrayLike, lat: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """WGS 84 degrees to map (x, y)."""
        x, y = _from_wgs84(self.crs).transform(lon, lat)
        return np.asarray(x) - self.x_origin, np.asarray(y) - self.y_origin

    def to_lonlat(self, x: ArrayLike, y: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Convert map (x, y) to WGS 84 degrees."""
        lon, lat = _from_wgs84(self.crs).transform(
            np.asarray(x, np.float64) + self.x_origin,
            np.asarray(y, np.float64) + self.y_origin,
            direction="INVERSE",
        )
        return np.asarray(lon), np.asarray(lat)

    def grid_convergence_deg(self, x: float, y: float) -> float:
        """Return the meridian convergence at a map point: how far grid north lies clockwise of true north, degrees."""
        lon, lat = self.to_lonlat(x, y)
        factors = Proj(self.crs).get_factors(float(lon), float(lat))
        return float(factors.meridian_convergence)

    def true_to_grid_deg(self, azimuth_deg: float, x: float, y: float) -> float:
        """Return an azimuth from true north as the azimuth from grid north at a map point, degrees in [0, 360)."""
        return (azimuth_deg - self.grid_convergence_deg(x, y)) % 360.0

    def magnetic_to_grid_deg(self, azimuth_deg: float, x: float, y: float, on: date, height: float = 0.0) -> float:
        """Return a compass azimuth as the azimuth from grid north, degrees in [0, 360). Declination: WMM, see below."""
        lon, lat = self.to_lonlat(x, y)
        true = azimuth_deg + magnetic_declination_deg(float(lon), float(lat), on, height)
        return self.true_to_grid_deg(true, x, y)


def magnetic_declination_deg(lon: float, lat: float, on: date, height: float = 0.0) -> float:
    """Return the magnetic declination (east positive), degrees, from the World Magnetic Model of the epoch of `on`.

    `height`: metres above the ellipsoid. Raises ConfigError outside the years that the models cover (2010-2029).
    """
    from pygeomag import GeoMag

    year = on.year + (on.timetuple().tm_yday - 1) / 365.25
    epochs = {
        2010: "wmm/WMM_2010.COF",
        2015: "wmm/WMM_2015v2.COF",
        2020: "wmm/WMM_2020.COF",
        2025: "wmm/WMM_2025.COF",
    }
    epoch = 5 * math.floor(year / 5)
    if epoch not in epochs:
        raise ConfigError(f"no World Magnetic Model for {on}; the models cover 2010-2029; give true-north azimuths")
    model = GeoMag(coefficients_file=epochs[epoch])
    return float(model.calculate(glat=lat, glon=lon, alt=height / 1000, time=year).d)


@lru_cache(maxsize=16)
def _from_wgs84(crs: str) -> Transformer:
    return Transformer.from_crs("EPSG:4326", crs, always_xy=True)


_J2000_S = 946_728_000
"""Seconds from 1970 to noon of 1 January 2000, UTC."""


def sun_elevation(latitude: float, longitude: float, stamps_ns: ArrayLike) -> Float64Array:
    """Return the elevation of the sun's centre above the horizon, radians, without refraction; accurate to 0.01 degrees
    from 1950 to 2050.

    `latitude`, `longitude`: radians, north and east. `stamps_ns`: any shape. Source: J. J. Michalsky, "The Astronomical
    Almanac's algorithm for approximate solar position (1950-2050)", Solar Energy 40 (1988).
    """
    days = np.asarray(stamps_ns, np.float64) / 86_400e9 - _J2000_S / 86_400
    anomaly = np.radians(357.528 + 0.9856003 * days)
    mean_longitude = 280.460 + 0.9856474 * days
    ecliptic = np.radians(mean_longitude + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    tilt = np.radians(23.439 - 4e-7 * days)
    ascension = np.arctan2(np.cos(tilt) * np.sin(ecliptic), np.cos(ecliptic))
    declination = np.arcsin(np.sin(tilt) * np.sin(ecliptic))
    hours = 24 * ((days + 0.5) % 1)
    sidereal = np.radians(15 * (6.697375 + 0.0657098242 * days + hours))
    hour_angle = sidereal + longitude - ascension
    sine = np.sin(declination) * np.sin(latitude) + np.cos(declination) * np.cos(latitude) * np.cos(hour_angle)
    return np.asarray(np.arcsin(np.clip(sine, -1, 1)), np.float64)
