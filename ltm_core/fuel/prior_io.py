"""Read prior fuel maps: LANDFIRE GeoTIFFs, LCP and GeoTIFF landscapes, folders of single bands."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Float32Array, Int16Array
from ltm_core.fuel.codes import FuelSystem, fuel_models, is_custom, of_one_fuel_type, system_of_codes
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.overlays_io import barrier_codes, with_barriers
from ltm_core.fuel.prior import CANOPY_BANDS, FuelPrior, PriorConfig
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import open_raster
from ltm_core.storage.disk_io import is_folder, is_there

_NODATA_VALUES = (-9999, 32767)
"""Nodata values of LANDFIRE's downloads and of common use, whatever the file declares."""
_NAMES: Mapping[str, str] = {
    "fbfm40": r"[0-9]*fbfm40(?P<revision>([a-z][0-9]{0,3})?)|f40|40",
    "fbfm13": r"[0-9]*fbfm13(?P<revision>([a-z][0-9]{0,3})?)|f13|13",
    "cover": r"[0-9]*cc|cover",
    "height": r"[0-9]*ch|height",
    "base_height": r"[0-9]*cbh|base",
    "bulk_density": r"[0-9]*cbd|density",
    "elevation": r"dem|elev|elevation",
}
"""Words that identify the files of a folder, between characters that are neither letters nor digits: cc.tif,
LC22_CC_230.tif (LANDFIRE), US_200FBFM40.tif (its older downloads), fbfm40r5.tif and fbfm40b.tif (ELMFIRE)."""
_LANDSCAPE_BANDS: Mapping[str, int] = {
    "elevation": 1,
    "codes": 4,
    "cover": 5,
    "height": 6,
    "base_height": 7,
    "bulk_density": 8,
}
_BAND_COUNTS = (5, 7, 8, 10)
_ELMFIRE_BUILDING = 256
_BUILT = 91


@dataclass(frozen=True)
class _Band:
    path: Path
    band: int = 1
    factor: float = 1.0
    """Factor to LANDFIRE's unit."""


def load_prior(config: PriorConfig, geometry: GridGeometry) -> FuelPrior:
    """Load the prior on the fuel grid (in the site's CRS) by nearest cell, since codes cannot be averaged.

    Raises RasterError: a file that cannot be read or has no CRS, a folder without fuel codes or with several, codes
    that no system has, nothing on the grid.
    """
    bands = {name: band for name, band in _bands_of(config).items() if name != "elevation"}
    read = {name: _read(band, geometry, config.crs) for name, band in bands.items()}
    if "codes" in read:
        codes = read.pop("codes")
        read[system_of_codes(codes).value] = codes
    system = FuelSystem.FBFM40 if "fbfm40" in read else FuelSystem.FBFM13
    barriers = barrier_codes(config.barriers, geometry)
    for name in ("fbfm40", "fbfm13"):
        if name in read:
            path = bands.get(name, bands.get("codes", _Band(Path()))).path
            read[name] = _known_codes(read[name], FuelSystem(name), path, config.unknown_codes)
            read[name] = with_barriers(read[name], barriers)
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
    return FuelPrior(codes, geometry, system, canopy, beside, contradicting)


def prior_heights(config: PriorConfig, geometry: GridGeometry) -> Float32Array | None:
    """Return the elevations of the prior, (H, W) metres as stated, NaN for none; None: it has no elevations.

    They are for plausibility alone: a DEM in feet stands 3.28 times as high. Raises RasterError as `load_prior` does.
    """
    band = _bands_of(config).get("elevation")
    if band is None:
        return None
    heights = _read(band, geometry, config.crs)
    return np.where(heights == NODATA, np.float32(np.nan), heights.astype(np.float32))


def _bands_of(config: PriorConfig) -> dict[str, _Band]:
    """Return what to read from where: `codes` (of a system to be found out), or fbfm40 and fbfm13, and canopy bands."""
    if config.path is None:
        return {name: _Band(path) for name, path in config.files().items()}
    if is_folder(config.path):
        return _bands_of_folder(config.path, {name: _Band(path) for name, path in config.files().items()})
    if config.files():
        raise RasterError(
            f"{config.path}: not a folder, so {', '.join(config.files())} cannot be given with it; name all "
            "files, or a folder"
        )
    if not is_there(config.path):
        raise RasterError(f"{config.path}: no such file (prior fuel map of the site)")
    with open_raster(config.path) as source:
        count, is_lcp = source.count, source.driver == "LCP"
        tags = [source.tags(band) for band in range(1, count + 1)] if count in _BAND_COUNTS else []
    if count == 1:
        return {"codes": _Band(config.path)}
    if count not in _BAND_COUNTS:
        raise RasterError(f"{config.path}: has {count} bands; a landscape has 5, 7, 8 or 10, a fuel map one")
    has_crown = count in (8, 10)
    names = [name for name in _LANDSCAPE_BANDS if has_crown or name in ("elevation", "codes", "cover")]
    return {
        name: _Band(
            config.path,
            _LANDSCAPE_BANDS[name],
            _unit_factor(name, tags[_LANDSCAPE_BANDS[name] - 1], config.path) if is_lcp else 1.0,
        )
        for name in names
    }


def _bands_of_folder(folder: Path, named: Mapping[str, _Band]) -> dict[str, _Band]:
    """`named`: files that the configuration names itself."""
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() in (".tif", ".tiff", ".asc", ".img"))
    bands = dict(named)
    for name in (name for name in _NAMES if name not in named):
        found = _files_of(name, files)
        if len(found) > 1 and name != "elevation":
            raise RasterError(
                f"{folder}: {', '.join(p.name for p in found)} could all be {name}; name one: `fuel: {{prior: "
                f"{{path: {folder.name}, {name}: {folder.name}/{found[0].name}}}}}`"
            )
        if found:
            bands[name] = _Band(found[0])
    if not {"fbfm40", "fbfm13"} & bands.keys():
        there = ", ".join(p.name for p in files) or "no raster"
        raise RasterError(
            f"{folder}: no fuel codes in it (files like fbfm40.tif, LC22_F40_230.tif); found {there}: if one of "
            f"these contains them, name it: `fuel: {{prior: {{path: {folder.name}, fbfm40: FILE}}}}`"
        )
    return bands


def _files_of(name: str, files: Sequence[Path]) -> list[Path]:
    """Return those whose names hold a band's word; of a plain name and its revisions the plain one."""
    known = re.compile(rf"(^|[^a-z0-9])({_NAMES[name]})([^a-z0-9]|$)", re.IGNORECASE)
    found = [(path, match) for path in files if (match := known.search(path.stem))]
    plain = [path for path, match in found if not match.groupdict().get("revision")]
    return plain if len(plain) == 1 else [path for path, _ in found]


_LCP_FACTORS: Mapping[str, Mapping[str, float]] = {
    "elevation": {"0": 1.0, "1": 0.3048},
    "height": {"1": 10.0, "2": 3.048, "3": 1.0, "4": 0.3048},
    "base_height": {"1": 10.0, "2": 3.048, "3": 1.0, "4": 0.3048},
    "bulk_density": {"1": 100.0, "2": 1601.846, "3": 1.0, "4": 1.601846},
}
"""Factors by the header's unit codes: metres, feet for elevation; metres, feet, m x 10, ft x 10 for canopy; kg/m3,
lb/ft3, kg/m3 x 100, lb/ft3 x 1000."""


def _unit_factor(name: str, tags: Mapping[str, str], path: Path) -> float:
    if name not in _LCP_FACTORS:
        return 1.0
    usual = "0" if name == "elevation" else "3"
    unit = next((value for key, value in tags.items() if key.endswith("_UNIT")), usual)
    if unit not in _LCP_FACTORS[name]:
        raise RasterError(f"{path}: its {name} has the unknown unit {unit}")
    return _LCP_FACTORS[name][unit]


def _read(band: _Band, geometry: GridGeometry, crs: str | None) -> Int16Array:
    """Return a band on the grid by nearest cell, (H, W), NODATA where the file has none or does not reach."""
    from rasterio.enums import Resampling
    from rasterio.vrt import WarpedVRT

    with open_raster(band.path) as source:
        if source.crs is None and crs is None:
            raise RasterError(f"{band.path}: the raster has no CRS; give it with `fuel: {{prior: {{crs: ...}}}}`")
        kind = np.dtype(source.dtypes[band.band - 1])
        if kind.kind not in "iu" and not (kind.kind == "f" and band.band == 1):
            raise RasterError(f"{band.path}: band {band.band} is {kind}; codes and canopy must be integers")
        options: dict[str, Any] = {} if source.crs is not None else {"src_crs": crs}
        with WarpedVRT(
            source,
            crs=geometry.crs,
            transform=geometry.transform(),
            width=geometry.width,
            height=geometry.height,
            resampling=Resampling.nearest,
            src_nodata=source.nodata if source.nodata is not None else NODATA,
            nodata=NODATA if kind.kind != "u" else source.nodata,
            tolerance=0.001,
            dtype="int32" if kind.itemsize > 2 or kind.kind == "u" else "int16",
            **options,
        ) as warped:
            values = warped.read(band.band).astype(np.float64)
    unknown = np.isin(values, _NODATA_VALUES) | (values < -32768) | (values > 32767)
    return np.where(unknown, NODATA, np.round(values * band.factor)).astype(np.int16)


def _known_codes(codes: Int16Array, system: FuelSystem, path: Path, others: str) -> Int16Array:
    """Return the codes that the system has, and an analyst's own; the others as `PriorConfig.unknown_codes` wants them.
    Raises RasterError if it does not."""
    if others == "built":
        codes = np.where(codes == _ELMFIRE_BUILDING, np.int16(_BUILT), codes)
    known = (codes == NODATA) | is_custom(codes) | np.isin(codes, list(fuel_models().codes(system)))
    if known.all() or others == "keep":
        return codes
    if others == "nodata":
        return np.where(known, codes, np.int16(NODATA))
    values, counts = np.unique(codes[~known], return_counts=True)
    strange = ", ".join(f"{v} ({n} cells)" for v, n in zip(values[:5], counts[:5], strict=True))
    raise RasterError(
        f"{path}: contains codes that {system} does not define: {strange}; if they mark non-fuel (ELMFIRE: 256 for "
        "buildings), read them as unknown: `fuel: {prior: {path: ..., unknown_codes: nodata}}`, or as built-up land: "
        "`unknown_codes: built`, or copy them into exports: `unknown_codes: keep`"
    )
