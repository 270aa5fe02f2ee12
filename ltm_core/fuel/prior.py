"""Hold the prior fuel map of a site, and the configuration of its files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import model_validator

from ltm_core.base.errors import RasterError
from ltm_core.base.strict_model import Expert, StrictModel, Written
from ltm_core.base.types import Int16Array
from ltm_core.fuel.codes import FuelSystem
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.grid import GridGeometry


class BarrierConfig(StrictModel):
    """GeoJSON file (longitude and latitude, WGS 84) that does not burn: areas take cells that they cover by half, lines
    all cells that they cross, so that no fire passes between two of them."""

    path: Path
    """Path of the GeoJSON file, relative to the site file."""
    kind: Literal["built", "road", "water"]
    """Kind of barrier: water gets the code NB8 (98), others NB1 (91)."""

    @property
    def code(self) -> int:
        return 98 if self.kind == "water" else 91


class PriorConfig(StrictModel):
    """Prior fuel map: `path`, or single-band files by content, or both if `path` is a folder (a named file has
    precedence). A bare string is `path`.

    Paths are relative to the site file; any CRS that GDAL knows; nodata -9999 or LANDFIRE's 32767."""

    path: Path | None = None
    """Path of a landscape (LCP or GeoTIFF of 8 bands), of a single band of fuel codes, or of a folder of single bands
    named as by LANDFIRE, ELMFIRE or GridFire (fbfm40.tif, fbfm40r5.tif, LC22_F40_230.tif, US_200FBFM40.tif)."""
    fbfm40: Written[Path | None] = None
    """Path of a raster of FBFM40 codes."""
    fbfm13: Written[Path | None] = None
    """Path of a raster of FBFM13 codes."""
    cover: Written[Path | None] = None
    """Path of the canopy cover in %, as a fraction, in FARSITE's classes, or of LANDFIRE's EVC."""
    height: Written[Path | None] = None
    """Path of the canopy height in LANDFIRE's m x 10, or in the unit that the file states or its values show."""
    base_height: Written[Path | None] = None
    """Path of the canopy base height, likewise."""
    bulk_density: Written[Path | None] = None
    """Path of the canopy bulk density in LANDFIRE's kg/m3 x 100, or likewise."""
    crs: Written[str | None] = None
    """CRS of files that do not state one."""
    unknown_codes: Written[Literal["refuse", "nodata", "built", "keep"]] = "refuse"
    """Treatment of codes that no fuel system defines, such as 256 for buildings in ELMFIRE: reject the map, set the
    cells to unknown, read 256 as built (91) and reject others, or copy all of them into exports. Codes 14 to 89 are
    custom models in both systems and are always kept."""
    own_fbfm13: Expert[Literal["within_fuel_type", "as_given"]] = "within_fuel_type"
    """Use of an FBFM13 map beside the FBFM40 one in exports to FBFM13: keep it where both have the same fuel type
    (grass, shrub, timber, slash), or wherever it has a code. LANDFIRE's two maps differ in the type of up to 7 % of the
    cells."""
    barriers: tuple[BarrierConfig, ...] = ()
    """Vector layers of barriers, applied to the fuel map in order."""

    @model_validator(mode="before")
    @classmethod
    def _bare_path(cls, value: Any) -> Any:
        return {"path": value} if isinstance(value, str | Path) else value

    @model_validator(mode="after")
    def _one_source(self) -> PriorConfig:
        if self.path is None and not self.files():
            raise ValueError("give path, or files such as fbfm40 and cover")
        if self.path is None and self.fbfm40 is None and self.fbfm13 is None:
            raise ValueError("a prior fuel map needs fuel codes: give fbfm40 or fbfm13")
        return self

    def files(self) -> dict[str, Path]:
        """Return the single-band files that are given, by content."""
        names = ("fbfm40", "fbfm13", "cover", "height", "base_height", "bulk_density")
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    def described(self) -> str:
        """Return the names of the source files, without their folders."""
        files = list(self.files().items())
        named = [f"{name} {path.name}" for name, path in files]
        return ", ".join(([] if self.path is None else [self.path.name]) + named)


CANOPY_BANDS = ("cover", "height", "base_height", "bulk_density")


@dataclass(frozen=True, eq=False)
class FuelPrior:
    """An existing fuel map on the fuel grid.

    `codes`: (H, W) int16 fuel codes of `system`, NODATA where none is known. `canopy`: (4, H, W) int16 in LANDFIRE's
    units: cover %, height m x 10, base height m x 10, bulk density kg/m3 x 100; NODATA where unknown; None: not given.
    `fbfm13`: (H, W) int16, the FBFM13 map that came beside FBFM40 codes, NODATA where exports do not keep
    it. `contradicting`: cells in which it came with another fuel type than theirs. `remarks`: what was
    converted, dropped or not used of its files. Raises RasterError where shapes disagree."""

    codes: Int16Array
    geometry: GridGeometry
    system: FuelSystem = FuelSystem.FBFM40
    canopy: Int16Array | None = None
    fbfm13: Int16Array | None = None
    contradicting: int = 0
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        shape = self.geometry.shape
        bands = {
            "codes": (self.codes, shape),
            "canopy": (self.canopy, (len(CANOPY_BANDS), *shape)),
            "FBFM13 codes": (self.fbfm13, shape),
        }
        for name, (band, wanted) in bands.items():
            if band is not None and band.shape != wanted:
                raise RasterError(f"{name} of shape {band.shape} do not fit a fuel grid of {shape}")
        if not (self.codes != NODATA).any():
            raise RasterError("the prior fuel map has no code on the fuel grid; check that it covers the site")


def system_of(prior: FuelPrior | None) -> FuelSystem:
    """Return the system of a map's codes: that of its prior, or FBFM40 without one."""
    return FuelSystem.FBFM40 if prior is None else prior.system
