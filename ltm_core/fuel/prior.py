"""Read the prior fuel map of a site: LANDFIRE GeoTIFFs, LCP and GeoTIFF landscapes, folders of single bands."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import model_validator

from ltm_core.base.errors import RasterError
from ltm_core.base.strict_model import Expert, StrictModel, Written
from ltm_core.base.types import Float32Array, Int16Array
from ltm_core.fuel.band_values_io import in_landfire_units, read_quantity
from ltm_core.fuel.codes import CUSTOM, FuelSystem, fuel_models, of_one_fuel_type, system_of_codes
from ltm_core.fuel.fuel_bands_io import CODES, FuelBand, meaning, open_bands, quantity_of
from ltm_core.fuel.life_form import NODATA, NONBURNABLE
from ltm_core.fuel.overlays_io import BarrierConfig, barrier_codes
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.disk_io import is_folder, is_there


class PriorConfig(StrictModel):
    """Prior fuel map: `path`, or single-band files by content, or both if `path` is a folder (a named file has
    precedence). A bare string is `path`. Paths are relative to the site file; any CRS that GDAL knows; nodata -9999 or
    LANDFIRE's 32767."""

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
    def _one_source(self) -> "PriorConfig":
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
        named = [f"{name} {path.name}" for name, path in self.files().items()]
        return ", ".join([*([] if self.path is None else [self.path.name]), *named])


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


_ELMFIRE_BUILDING = 256
_BUILT = 91
_NOT_REPORTED = ("slope", "aspect", "elevation", "other")
"""Quantities of files in a folder that are not part of a prior fuel map, but usual beside it."""


def load_prior(config: PriorConfig, geometry: GridGeometry) -> FuelPrior:
    """Load the prior on the fuel grid (in the site's CRS) by nearest cell, since codes cannot be averaged. Raises
    RasterError: a file that cannot be read or has no CRS, a folder without fuel codes or with several, codes that no
    system has, canopy values that no unit explains, nothing on the grid."""
    bands, unused = _bands_of(config)
    # The terrain in a landscape shows whether its bands are where they are expected.
    wanted = [band for band in bands if band.quantity != "elevation" or band.path == config.path]
    read, remarks = in_landfire_units((band, read_quantity(band, geometry, config.crs)) for band in wanted)
    paths = {band.quantity: band.path for band in bands}
    if "codes" in read:
        codes = read.pop("codes")
        system = system_of_codes(codes)
        read[system.value], paths[system.value] = codes, paths["codes"]
    system = FuelSystem.FBFM40 if "fbfm40" in read else FuelSystem.FBFM13
    barriers = barrier_codes(config.barriers, geometry)
    for name in ("fbfm40", "fbfm13"):
        if name in read:
            codes = _known_codes(read[name], FuelSystem(name), paths[name], config.unknown_codes)
            read[name] = np.where((barriers != NODATA) & (codes != NODATA), barriers, codes)
    canopy = None
    if any(name in read for name in CANOPY_BANDS):
        unknown = np.full(geometry.shape, NODATA, np.int16)
        canopy = np.stack([read.get(name, unknown) for name in CANOPY_BANDS])
    codes, beside, contradicting = read[system.value], None, 0
    if system is FuelSystem.FBFM40 and "fbfm13" in read:
        beside, same = read["fbfm13"], of_one_fuel_type(codes, read["fbfm13"])
        contradicting = int((~same).sum())
        if config.own_fbfm13 == "within_fuel_type":
            beside = np.where(same, beside, NODATA).astype(np.int16)
    return FuelPrior(codes, geometry, system, canopy, beside, contradicting, (*unused, *remarks))


def prior_heights(config: PriorConfig, geometry: GridGeometry) -> Float32Array | None:
    """Return the elevations of the prior, (H, W) metres as stated, NaN for none; None: it has no elevations. They are
    for plausibility alone: a DEM in feet stands 3.28 times as high. Raises RasterError as `load_prior` does."""
    band = next((band for band in _bands_of(config)[0] if band.quantity == "elevation"), None)
    if band is None:
        return None
    read, _ = in_landfire_units([(band, read_quantity(band, geometry, config.crs))])
    heights = read["elevation"]
    return np.where(heights == NODATA, np.float32(np.nan), heights.astype(np.float32))


def _bands_of(config: PriorConfig) -> tuple[list[FuelBand], list[str]]:
    """Return what to read from where, height before base height, and remarks about files that are not used."""
    if config.path is None or is_folder(config.path):
        # The band of each file that the configuration names; an error if a file states otherwise.
        named = [band for name, path in config.files().items() for band in open_bands(path, name)]
        return (named, []) if config.path is None else _bands_of_folder(config.path, named)
    if config.files():
        raise RasterError(
            f"{config.path}: not a folder, so {', '.join(config.files())} cannot be given with it; name all "
            "files, or a folder"
        )
    if not is_there(config.path):
        raise RasterError(f"{config.path}: no such file (prior fuel map of the site)")
    bands = open_bands(config.path)
    if not any(band.quantity in CODES for band in bands):
        raise RasterError(
            f"{config.path}: holds {', '.join(band.quantity for band in bands)}, no fuel codes; give a fuel map such "
            "as LANDFIRE's FBFM40, or name this one's band so (`rio edit-info --bidx 1 --description FBFM40 FILE`)"
        )
    return bands, []


def _bands_of_folder(folder: Path, named: list[FuelBand]) -> tuple[list[FuelBand], list[str]]:
    """`named`: files that the configuration names itself."""
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() in (".tif", ".tiff", ".asc", ".img"))
    known = {path: quantity_of(path) for path in files}
    bands, taken = list(named), {band.quantity: band.path for band in named}
    for name in (*CODES, *CANOPY_BANDS, "elevation"):
        if name in taken or (name == "codes" and taken.keys() & set(CODES)):
            continue
        found = [path for path in files if known[path] == name and path not in taken.values()]
        plain = [path for path in found if not (meaning(path.stem) or (name, False))[1]]
        found = plain if len(plain) == 1 else found
        if len(found) > 1 and name != "elevation":
            raise RasterError(
                f"{folder}: {', '.join(p.name for p in found)} could all be {name}; name one: `fuel: {{prior: "
                f"{{path: {folder.name}, {name}: {folder.name}/{found[0].name}}}}}`"
            )
        if found:
            taken[name] = found[0]
            bands += open_bands(found[0], name)
    if not taken.keys() & set(CODES):
        there = ", ".join(p.name for p in files) or "no raster"
        raise RasterError(
            f"{folder}: no fuel codes in it (files like fbfm40.tif, LC22_F40_230.tif); found {there}: if one of "
            f"these contains them, name it: `fuel: {{prior: {{path: {folder.name}, fbfm40: FILE}}}}`"
        )
    unused = [p.name for p in files if p not in taken.values() and known[p] not in _NOT_REPORTED]
    remark = f"{folder}: not used: {', '.join(unused)}; name what they hold in `fuel: {{prior: ...}}` or remove them"
    return bands, [remark] if unused else []


def _known_codes(codes: Int16Array, system: FuelSystem, path: Path, others: str) -> Int16Array:
    """Return the codes that the system has, and an analyst's own; the others as `PriorConfig.unknown_codes` wants them.
    Raises RasterError if it does not, and for a map that has cells of each known kind of another quantity."""
    standard = [*fuel_models().codes(system)]
    values, counts = np.unique(codes[codes != NODATA], return_counts=True)
    ours = np.isin(values, standard)
    other = ~ours & ~np.isin(values, [*CUSTOM])  # a custom model has no table entry
    looks = ""
    if other.sum() > 1 and 2 * counts[other].sum() > counts.sum():
        looks = "a vegetation type or another quantity"
    elif not ours.any() and np.isin(values, (0, *range(5, 100, 10))).all():
        looks = "LANDFIRE's canopy cover"
    elif set(range(1, CUSTOM.start + 5)) <= set(values.tolist()) and (ours & ~np.isin(values, NONBURNABLE)).any():
        looks = "the indices of a colour table"
    if looks:
        listed = ", ".join(str(value) for value in values[:6])
        raise RasterError(f"{path}: no map of {system}: its values ({listed}, ...) look like {looks}; give fuel codes")
    if others == "built":
        codes = np.where(codes == _ELMFIRE_BUILDING, np.int16(_BUILT), codes)
    unknown = ~np.isin(codes, [NODATA, *CUSTOM, *standard])
    if not unknown.any() or others == "keep":
        return codes
    if others == "nodata":
        return np.where(unknown, np.int16(NODATA), codes)
    values, counts = np.unique(codes[unknown], return_counts=True)
    strange = ", ".join(f"{v} ({n} cells)" for v, n in zip(values[:5], counts[:5], strict=True))
    raise RasterError(
        f"{path}: contains codes that {system} does not define: {strange}; if they mark non-fuel (ELMFIRE: 256 for "
        "buildings), read them as unknown: `fuel: {prior: {path: ..., unknown_codes: nodata}}`, or as built-up land: "
        "`unknown_codes: built`, or copy them into exports: `unknown_codes: keep`"
    )
