"""What a site needs from a data source, and what the source delivered."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from ltm_core.base.errors import ConfigError

METRES_PER_DEGREE = 111_320.0
"""Length of a degree of latitude (and of longitude at the equator)."""


class Kind(StrEnum):
    """The rasters of a site."""

    ELEVATION = "elevation"
    COARSE_ELEVATION = "coarse_elevation"
    SURFACE = "surface"
    FUEL = "fuel"


@dataclass(frozen=True)
class Area:
    """A rectangle on the Earth.

    Args:
        bounds_lonlat: west, south, east and north, degrees.
    """

    bounds_lonlat: tuple[float, float, float, float]

    def __post_init__(self) -> None:
        west, south, east, north = self.bounds_lonlat
        if not (-180.0 <= west < east <= 180.0 and -90.0 <= south < north <= 90.0):
            raise ConfigError(
                f"the area {self.bounds_lonlat} is not (west, south, east, north) in degrees; give longitudes in "
                "[-180, 180] and latitudes in [-90, 90], and no area across the 180th meridian"
            )

    @classmethod
    def around(cls, lon: float, lat: float, radius_m: float) -> Area:
        """Return the rectangle that contains a circle."""
        if not (math.isfinite(radius_m) and radius_m > 0.0):
            raise ConfigError(f"the radius is {radius_m:g} m; give a length above 0")
        up = radius_m / METRES_PER_DEGREE
        side = up / max(math.cos(math.radians(min(abs(lat) + up, 89.0))), 1e-3)
        return cls((lon - side, lat - up, lon + side, lat + up))

    @property
    def size_m(self) -> tuple[float, float]:
        """Return the width and height, metres."""
        west, south, east, north = self.bounds_lonlat
        at_latitude = math.cos(math.radians((south + north) / 2))
        return (east - west) * METRES_PER_DEGREE * at_latitude, (north - south) * METRES_PER_DEGREE


@dataclass(frozen=True)
class Fetched:
    """Rasters as a source delivered them: several files are tiles that join or overlap, in any CRS."""

    files: tuple[Path, ...]
    source: str
    licence: str
    vertical_crs: str | None
    """CRS of the heights, such as EPSG:5703 (NAVD88), EPSG:3855 (EGM2008) or EPSG:4979 (ellipsoidal)."""
    resolution_m: float
    year: int | None
    urls: tuple[str, ...]
    bytes_read: int
