"""Read, check and compare CRSs; convert coordinates and north references; compute the sun's elevation.

Compass north, true north and grid north are three things; this is the one place that converts between them."""

import contextlib
import math
from dataclasses import dataclass
from datetime import date
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS, Proj, Transformer
from pyproj.aoi import AreaOfInterest
from pyproj.database import query_utm_crs_info
from pyproj.exceptions import CRSError, ProjError

from ltm_core.base.errors import ConfigError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.grid import GridGeometry

EARTH_RADIUS = 6_371_008.8
"""Mean radius of the WGS 84 ellipsoid in metres (IUGG R1)."""


def ray_bend(curvature: bool, refraction: float) -> float:
    """Return the coefficient c of a ray's height z(r) = z0 + s r + c r^2 over horizontal range r, 1/metres.

    The earth falls away by r^2 / 2R and standard air bends light by the share `refraction` (k) of that back down:
    c = (1 - k) / (2 R). Zero on a flat earth. Source: surveying's combined correction, e.g. Torge, Geodesy, 5.1."""
    if not 0 <= refraction < 1:
        raise ConfigError(f"refraction coefficient must lie in [0, 1), standard air is 0.13; got {refraction}")
    return (1 - refraction) / (2 * EARTH_RADIUS) if curvature else 0.0


def read_crs(text: Any) -> CRS:
    """Return the CRS of a code, a PROJ string, WKT or another library's object. Raises ConfigError if it is unknown."""
    try:
        return CRS.from_user_input(text)
    except CRSError as error:
        raise ConfigError(f"unknown CRS {str(text)!r}: give an EPSG code such as EPSG:32611 ({error})") from error


def horizontal(crs: CRS) -> CRS:
    """Return the horizontal part of a CRS: lidar DEMs often have a compound CRS, a site does not."""
    if crs.is_compound:
        return crs.sub_crs_list[0]
    return crs.to_2d() if len(crs.axis_info) > 2 else crs


@lru_cache(maxsize=64)
def same_crs(a: Any, b: Any) -> bool:
    """Return whether two CRSs, in any notation, give a place on the map the same coordinates.

    Heights, names, the order of axes and a stated shift to WGS 84 do not matter. A datum that is stated only as an
    ellipsoid equals every datum on that ellipsoid; two named datums are equal only if PROJ says so. None equals None.
    """
    if a is None or b is None or str(a) == str(b):
        return (a is None) == (b is None)
    first, second = (_unbound(horizontal(read_crs(crs))) for crs in (a, b))
    if first.equals(second, ignore_axis_order=True):
        return True
    base, other = first.geodetic_crs, second.geodetic_crs
    if not (first.is_projected and second.is_projected and base and other):
        return False
    unnamed = any("unknown" in str(crs.datum and crs.datum.name).lower() for crs in (base, other))
    if not unnamed and not base.equals(other, ignore_axis_order=True):
        return False
    lon, lat = np.meshgrid(np.arange(-180.0, 180.0, 7.0), np.arange(-85.0, 90.0, 7.0))
    places = np.array([Proj(crs)(lon, lat) for crs in (first, second)])
    there = np.isfinite(places).all(axis=(0, 1))
    return bool(there.any() and np.ptp(places[:, :, there], axis=0).max() < 1e-3)


def _unbound(crs: CRS) -> CRS:
    return crs.source_crs if crs.is_bound and crs.source_crs is not None else crs


def name_of(crs: CRS) -> str:
    """Return `EPSG:...` if the CRS has such a code, else WKT. A code that PROJ only guesses is not taken."""
    for candidate in (crs, _unbound(crs)):
        authority = candidate.to_authority()
        if authority and CRS(":".join(authority)).equals(candidate, ignore_axis_order=True):
            return ":".join(authority)
    return str(crs.to_wkt())


def map_problem(crs: CRS) -> str | None:
    """Return why a CRS cannot be a map's, and what to do; None if it is projected, in metres, with x east and y north,
    and states no heights above the ellipsoid."""
    if not crs.is_projected or any(abs(axis.unit_conversion_factor - 1) > 1e-9 for axis in crs.axis_info[:2]):
        return f"{crs.name} is not projected in metres; use one that is, such as the UTM zone (gdalwarp -t_srs)"
    directions = {axis.direction for axis in crs.axis_info[:2]}
    if not directions <= {"east", "north"} and len(directions) > 1:
        return (
            f"axes of {crs.name} point {' and '.join(sorted(directions))}; use a CRS with x east and y north, such as "
            "the UTM zone (gdalwarp -t_srs)"
        )
    return ellipsoidal_problem(crs)


def ellipsoidal_problem(crs: CRS) -> str | None:
    """Return that the heights of a CRS are above the ellipsoid, and what to do; None if they are not, or not stated."""
    vertical = crs.sub_crs_list[1] if crs.is_compound and len(crs.sub_crs_list) > 1 else None
    if vertical is None:
        above = len(crs.axis_info) > 2
    else:
        above = "ellipsoid" in f"{vertical.name} {vertical.datum and vertical.datum.name}".lower()
    if not above:
        return None
    flat = name_of(horizontal(crs))
    return (
        f"heights of {crs.name} are above the ellipsoid, up to 100 m off those above sea level; convert them (gdalwarp "
        f"-t_srs {flat}+3855, with PROJ's geoid grids), or, if cameras have such heights too, state only {flat}"
    )


MOST_DISTORTION, MOST_EXPORTED = 0.002, 0.02
"""Maximum relative error of distances on a site's map and on exported grids. UTM has 0.0004 on its central meridian,
LANDFIRE's Albers up to 0.013 in the United States."""


def scale_problem(crs: Any, geometry: GridGeometry, most: float = MOST_DISTORTION) -> str | None:
    """Return why distances over a raster in a projected CRS are wrong by more than the share `most`, with a suitable
    CRS; None if they are not. They are compared at its corners, its centre and the middles of its sides."""
    projection = Proj(_unbound(horizontal(read_crs(crs))))
    x, y = (np.linspace(low, high, 3) for low, high in zip(geometry.bounds[:2], geometry.bounds[2:], strict=True))
    lon, lat = (np.ravel(v) for v in projection(*np.meshgrid(x, y), inverse=True))
    worst, at = 0.0, 0
    for k, place in enumerate(zip(lon, lat, strict=True)):
        off = math.inf
        if np.isfinite(place).all():
            with contextlib.suppress(ProjError):
                factors = projection.get_factors(*place)
                off = max(abs(factors.tissot_semimajor - 1), abs(factors.tissot_semiminor - 1))
        if not off <= worst:
            worst, at = off, k
    if worst <= most:
        return None
    name = read_crs(crs).name
    if not math.isfinite(worst):
        return f"{name} is not defined there; use the UTM zone of the place"
    zones = query_utm_crs_info("WGS 84", AreaOfInterest(lon[at], lat[at], lon[at], lat[at]), contains=True)
    suitable = f"EPSG:{zones[0].code}" if zones else "a projection with true scale there"
    return (
        f"distances in {name} are up to {worst:.2%} wrong at {lat[at]:.3f}, {lon[at]:.3f} (at most {most:.1%} is "
        f"allowed); use {suitable} (gdalwarp -r bilinear -t_srs {suitable})"
    )


@dataclass(frozen=True)
class SiteFrame:
    """The map frame of a site: a projected CRS in metres minus an origin; z stays orthometric.

    With an origin near the site, float32 coordinates keep millimetres. Raises ConfigError where the CRS is unknown or
    not a map's (see `map_problem`)."""

    crs: str
    x_origin: float = 0.0
    y_origin: float = 0.0

    def __post_init__(self) -> None:
        problem = map_problem(read_crs(self.crs))
        if problem is not None:
            raise ConfigError(f"CRS {self.crs!r}: {problem}")

    def from_lonlat(self, lon: ArrayLike, lat: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """WGS 84 degrees to map (x, y)."""
        x, y = _from_wgs84(self.crs).transform(lon, lat)
        return np.asarray(x) - self.x_origin, np.asarray(y) - self.y_origin

    def to_lonlat(self, x: ArrayLike, y: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Convert map (x, y) to WGS 84 degrees."""
        lon, lat = _from_wgs84(self.crs).transform(
            np.asarray(x, np.float64) + self.x_origin, np.asarray(y, np.float64) + self.y_origin, direction="INVERSE"
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

    `height`: metres above the ellipsoid. Raises ConfigError outside the years that the models cover (2010-2029)."""
    from pygeomag import GeoMag

    year = on.year + (on.timetuple().tm_yday - 1) / 365.25
    epochs = {2010: "wmm/WMM_2010.COF", 2015: "wmm/WMM_2015v2.COF", 2020: "wmm/WMM_2020.COF", 2025: "wmm/WMM_2025.COF"}
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
    Almanac's algorithm for approximate solar position (1950-2050)", Solar Energy 40 (1988)."""
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
