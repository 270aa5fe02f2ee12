"""What a site needs from a data source, and what the source delivered."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import Field

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.base.strict_model import StrictModel
from ltm_core.raster.dem import Bounds

METRES_PER_DEGREE = 111_320.0
"""Length of a degree of longitude at the equator, and of latitude within 0.7 %."""

Kind = Literal["dem", "coarser", "surface", "fuel"]
"""The rasters of a site, by their keys for `ltm init --update`."""


@dataclass(frozen=True)
class Area:
    """A rectangle on the Earth: west, south, east and north, degrees."""

    bounds_lonlat: Bounds

    def __post_init__(self) -> None:
        west, south, east, north = self.bounds_lonlat
        if not (-180.0 <= west < east <= 180.0 and -90.0 <= south < north <= 90.0):
            raise ConfigError(
                f"the area {self.bounds_lonlat} is not (west, south, east, north) in degrees; give longitudes in "
                "[-180, 180] and latitudes in [-90, 90], and no area across the 180th meridian"
            )

    @property
    def size_m(self) -> tuple[float, float]:
        """Return the width and height, metres."""
        west, south, east, north = self.bounds_lonlat
        at_latitude = math.cos(math.radians((south + north) / 2))
        return (east - west) * METRES_PER_DEGREE * at_latitude, (north - south) * METRES_PER_DEGREE

    def padded(self, margin_m: float) -> "Area":
        """Return the area with a margin, cut at the poles and at the 180th meridian."""
        west, south, east, north = self.bounds_lonlat
        up = margin_m / METRES_PER_DEGREE
        side = up / max(math.cos(math.radians((south + north) / 2)), 0.01)
        return Area((max(west - side, -180.0), max(south - up, -90.0), min(east + side, 180.0), min(north + up, 90.0)))

    def __str__(self) -> str:
        west, south, east, north = self.bounds_lonlat
        return f"{west:.3f} to {east:.3f} longitude, {south:.3f} to {north:.3f} latitude"


class FetchError(LtmError):
    """Data of a service cannot be had."""


class NoCoverageError(FetchError):
    """A source has no data in an area."""


Progress = Callable[[int, int], None]
"""Receives the bytes fetched so far and the bytes expected."""


class SourceConfig(StrictModel):
    """An entry of `config/sources.yaml`."""

    kinds: tuple[Kind, ...] = Field(min_length=1)
    """The source can deliver these rasters."""
    protocol: Literal["tiles", "tnm", "stac", "url", "opentopography", "landfire", "wcs"]
    """The service answers requests of this form."""
    address: str = Field(pattern=r"^https?://")
    """The URL of the service, or the template of its tiles: {north}, {south}, {west} (n35, w119; {NORTH}: N35) and
    {quadkey} are filled in for tiles, {layer} and {year} for coverages."""
    licence: str
    """The licence is named in the provenance of each raster."""
    resolution_m: float = Field(gt=0)
    """The cell size is given in metres."""
    vertical_crs: str | None = None
    """The heights refer to this CRS, such as EPSG:5703 (NAVD88); none: unknown, or not heights."""
    year: int | None = None
    """The data show the land of this year."""
    coverage: tuple[Bounds, ...] = ((-180.0, -90.0, 180.0, 90.0),)
    """The data lie within these boxes of west, south, east and north, degrees."""
    above_ground: bool = False
    """The values are heights of the canopy above the ground, metres."""
    nodata: float | None = None
    """This value marks unknown cells if the files do not declare one."""
    tile_degrees: float = 1.0
    """The tiles of a template have this side, degrees."""
    quadkey_zoom: int = 0
    """The tiles of a template are those of web maps at this zoom; 0: tiles of degrees."""
    collection: str = ""
    """The data set is named so at the service (tnm, stac)."""
    asset: str = "data"
    """The asset of a STAC item is read."""
    layers: tuple[str, ...] = ()
    """These layers are fetched (landfire, wcs)."""
    key: str = ""
    """This environment variable holds the key, or the e-mail address, that the service requires."""
    key_from: str = ""
    """The key is issued here."""
    most_km2: float = Field(default=math.inf, gt=0, allow_inf_nan=True)
    """The service delivers at most this area, square kilometres."""
    sha256: str = Field(default="", pattern=r"^([0-9a-f]{64})?$")
    """The file has this checksum (url); it is then downloaded whole."""


@dataclass(frozen=True)
class Remote:
    """A file on a server. `version`: ETag, modification time, or empty. `ranges`: it is delivered in parts."""

    url: str
    size: int
    version: str
    ranges: bool


@dataclass(frozen=True)
class Part:
    """One file, or one window of a file, that a plan reads into the file `name`.

    `remote`: the file on the server, if it exists before the request. `window`: first column, first row, columns and
    rows; None: the whole file. `tile`: parts of one tile show the same ground; a later one is fetched only if the
    former ones have holes."""

    url: str
    name: str
    expected_bytes: int
    remote: Remote | None = None
    window: tuple[int, int, int, int] | None = None
    tile: str = ""


@dataclass(frozen=True)
class Plan:
    """What a source will fetch for an area. `notes`: for the user, such as why other sources are not used."""

    area: Area
    parts: tuple[Part, ...]
    notes: tuple[str, ...] = ()
    year: int | None = None

    @property
    def expected_bytes(self) -> int:
        """Return the bytes that are fetched at most."""
        return sum(part.expected_bytes for part in self.parts)


@dataclass(frozen=True)
class Fetched:
    """Rasters as a source delivered them: several files are tiles that join or overlap, in any CRS.

    `vertical_crs`: of the heights, such as EPSG:5703 (NAVD88), EPSG:3855 (EGM2008) or EPSG:4979 (ellipsoidal).
    `above_ground`: the values are canopy heights above the ground, not elevations."""

    files: tuple[Path, ...]
    source: str
    licence: str
    vertical_crs: str | None
    year: int | None
    urls: tuple[str, ...]
    above_ground: bool = False
