"""Find out what a raster band of terrain, fuel or canopy holds, and read it in LANDFIRE's unit.

Attribute tables, band descriptions and file names decide what a band holds; positions count only in a landscape that
names no band. Stated units, and without them the values, decide the unit.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final
from xml.etree.ElementTree import ParseError, fromstring

import numpy as np

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Float64Array, Int16Array
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import check_size, open_raster
from ltm_core.storage.disk_io import is_file

CODES: Final = ("fbfm40", "fbfm13", "codes")
_REVISION = r"(?P<revision>[a-z][0-9]{0,3})?"
_WORDS: Final[Mapping[str, str]] = {
    "fbfm40": rf"[0-9]*fbfm_?40{_REVISION}|[0-9]*f40|fm_?40|sb_?40|scott_(and_)?burgan(_40)?|fuel_models?_40",
    "fbfm13": rf"[0-9]*fbfm_?13{_REVISION}|[0-9]*f13|fm_?13|anderson(_13)?|fuel_models?_13",
    "cover": r"[0-9]*cc|(canopy|crown|tree)_(cover|closure)",
    "height": r"[0-9]*ch|(canopy|crown|stand|tree)_(height|ht)",
    "base_height": r"[0-9]*cbh|((canopy|crown)_)?base_(height|ht)",
    "bulk_density": r"[0-9]*cbd|((canopy|crown)_)?bulk_density",
    "elevation": r"[0-9]*(dem|elev)[0-9]*|elevation",
    "slope": r"[0-9]*slp[0-9]*(_?[dp])?|slope",
    "aspect": r"[0-9]*asp[0-9]*|aspect",
    "vegetation": r"[0-9]*(evt|evc|evh|bps|nvc|fccs)",
    "other": r"duff|woody|adj|phi|ws|wd|m1|m10|m100|mlh|mlw",
}
"""Words that identify a band between characters that are neither letters nor digits: CC, LC22_CC_230 (LANDFIRE),
US_200FBFM40 (its older downloads), fbfm40r5 (ELMFIRE), CanopyBaseHeight. `other` are further inputs of fire models."""
_ALONE: Final[Mapping[str, str]] = {
    "codes": r"(surface_)?fuels?(_(models?|codes?))?|fbfm",
    "cover": "cover",
    "height": "height",
    "base_height": "base",
    "bulk_density": "density",
}
"""Words that identify a band only if nothing but numbers stands beside them."""
POSITIONS: Final = ("elevation", "slope", "aspect", "codes", "cover", "height", "base_height", "bulk_density")
_GROUND: Final = ("duff", "woody")
_LAYOUTS: Final[Mapping[int, tuple[str, ...]]] = {
    5: POSITIONS[:5],
    7: (*POSITIONS[:5], *_GROUND),
    8: POSITIONS,
    10: (*POSITIONS, *_GROUND),
}
_RANGES: Final[Mapping[str, tuple[float, float]]] = {
    "elevation": (-500, 9000),
    "slope": (0, 90),
    "aspect": (-1, 360),
    "cover": (0, 100),
    "height": (0, 1200),
    "base_height": (0, 1000),
    "bulk_density": (0, 300),
}
"""Plausible values in LANDFIRE's units."""
_LENGTHS: Final = {"m": 10.0, "ft": 3.048, "mx10": 1.0, "dm": 1.0, "ftx10": 0.3048, "cm": 0.1}
_FACTORS: Final[Mapping[str, Mapping[str, float]]] = {
    "elevation": {"m": 1.0, "ft": 0.3048, "dm": 0.1, "cm": 0.01},
    "cover": {"%": 1.0, "percent": 1.0, "pct": 1.0, "1": 100.0, "fraction": 100.0},
    "height": _LENGTHS,
    "base_height": _LENGTHS,
    "bulk_density": {"kg/m3": 100.0, "kg/m3x100": 1.0, "lb/ft3": 1601.846, "lb/ft3x1000": 1.601846},
}
"""Factors from a stated unit to LANDFIRE's: m, %, m x 10, kg/m3 x 100."""
_SPELLINGS: Final = (
    (r"us.?survey|international|\*\*|[\s^()]", ""),
    ("met(er|re)s?", "m"),
    ("feet|foot", "ft"),
    ("kgm-3", "kg/m3"),
    (r"\*", "x"),
)
_PHYSICAL: Final = {"cover": "%", "height": "m", "base_height": "m", "bulk_density": "kg/m3"}
"""Units of values with a scale factor, if no other is stated."""
_LCP_UNITS: Final[Mapping[str, tuple[str, Mapping[str, str]]]] = {
    "elevation": ("ELEVATION_UNIT", {"0": "m", "1": "ft"}),
    "slope": ("SLOPE_UNIT", {"0": "degrees", "1": "percent"}),
    "aspect": ("ASPECT_UNIT", {"2": "degrees"}),
    "codes": ("FUEL_MODEL_OPTION", {"0": "code", "1": "code"}),
    "cover": ("CANOPY_COV_UNIT", {"0": "class", "1": "%"}),
    "height": ("CANOPY_HT_UNIT", {"1": "m", "2": "ft", "3": "mx10", "4": "ftx10"}),
    "base_height": ("CBH_UNIT", {"1": "m", "2": "ft", "3": "mx10", "4": "ftx10"}),
    "bulk_density": ("CBD_UNIT", {"1": "kg/m3", "2": "lb/ft3", "3": "kg/m3x100", "4": "lb/ft3x1000"}),
}
"""Unit codes of LCP headers as GDAL reports them. Codes of fuel options 2 and 3 need a conversion file, and aspects
of units 0 and 1 are not azimuths."""
_CLASSES: Final = np.array([0.0, 10.0, 35.0, 65.0, 90.0])
"""Cover in % of FARSITE's classes 0 to 4: none, 1 to 20, 21 to 50, 51 to 80 and 81 to 100 %."""
_STRAY: Final = 0.01
"""Maximum share of cells with implausible values, which become unknown; a band with more is rejected."""
STATE_UNIT: Final = "state its unit in the file, such as `rio edit-info --bidx 1 --units m FILE`"


@dataclass(frozen=True)
class FuelBand:
    """A band and what it holds. `unit`: as stated, empty: unknown."""

    path: Path
    quantity: str
    index: int = 1
    unit: str = ""

    @property
    def place(self) -> str:
        return f"{self.path}, band {self.index} ({self.quantity})"


def _words(text: str) -> str:
    """Return lower-case words joined by underscores, with those of CamelCase apart."""
    return re.sub(r"[^a-z0-9]+", "_", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", text).lower()).strip("_")


def meaning(text: str) -> tuple[str, bool] | None:
    """Return the quantity that a name states and whether the name is one of a revision; None if it states none, or
    several."""
    words, found = _words(text), {}
    for quantity, pattern in _WORDS.items():
        if match := re.search(rf"(?:^|_)(?:{pattern})(?=_|$)", words):
            found[quantity] = bool(match.groupdict().get("revision"))
    if not found:
        plain = re.sub(r"(^|_)[0-9]+(?=_|$)", "", words).strip("_")
        found = {quantity: False for quantity, pattern in _ALONE.items() if re.fullmatch(pattern, plain)}
    return next(iter(found.items())) if len(found) == 1 else None


def quantity_of(path: Path, description: str | None = None) -> str | None:
    """Return what the single band of a file holds, by its attribute table, description or name; None: not stated."""
    for text in (*_table_columns(path), description or "", path.stem):
        if found := meaning(text):
            return found[0]
    return None


def _table_columns(path: Path) -> list[str]:
    """Return the column names of the attribute table beside a raster (.vat.dbf, .aux.xml), none if unreadable."""
    table, aux = (path.with_name(f"{path.name}{suffix}") for suffix in (".vat.dbf", ".aux.xml"))
    try:
        if is_file(table):
            with table.open("rb") as file:
                head = file.read(struct.unpack("<H", file.read(32)[8:10])[0] - 32)
            return [head[k : k + 11].split(b"\0")[0].decode("ascii", "replace") for k in range(0, len(head) - 31, 32)]
        if is_file(aux) and aux.stat().st_size < 1 << 20:
            return [str(node.text) for node in fromstring(aux.read_bytes()).iterfind(".//FieldDefn/Name")]
    except (OSError, ParseError, struct.error):
        pass
    return []


def open_bands(path: Path, wanted: str | None = None) -> list[FuelBand]:
    """Return the known bands of a file as `file_bands`, or the one that holds `wanted`. Raises RasterError if the file
    says that it holds something else."""
    with open_raster(path) as source:
        bands = file_bands(source, path, wanted)
    if wanted is None:
        return bands
    like = {wanted, "codes"} if wanted in CODES else {wanted, "vegetation"} if wanted == "cover" else {wanted}
    found = [replace(band, quantity=wanted) for band in bands if band.quantity in like]
    if not found:
        raise RasterError(
            f"{path}: given as {wanted}, but holds {', '.join(band.quantity for band in bands)} by its names; give the "
            "right file, or name the band in its description (`rio edit-info --bidx 1 --description NAME FILE`)"
        )
    return found


def file_bands(source: Any, path: Path, default: str | None = None) -> list[FuelBand]:
    """Return the bands of a landscape or single-band file that hold something known, `codes` of an unknown system, base
    height last. `default`: quantity of a single band that states none.

    Raises RasterError: several bands of one quantity, names without fuel codes, or neither names nor a known number.
    """
    names = _band_names(source)
    quantities: Sequence[str | None]
    if len(names) == 1:
        quantities = [quantity_of(path, names[0]) or default or "codes"]
    elif any(quantities := [found and found[0] for found in map(meaning, names)]):
        if not set(quantities) & set(CODES):
            raise RasterError(f"{path}: no band is named as fuel codes ({', '.join(names)}); name it FBFM40 or FBFM13")
    elif len(names) in _LAYOUTS:
        quantities = _LAYOUTS[len(names)]
    else:
        raise RasterError(
            f"{path}: has {len(names)} bands without known names; a landscape has 5, 7, 8 or 10, a fuel map one. "
            "Name the bands (FBFM40, CC, CH, CBH, CBD) in their descriptions"
        )
    bands = [
        FuelBand(path, quantity, index, _stated_unit(source, quantity, index, names[index - 1]))
        for index, quantity in enumerate(quantities, start=1)
        if quantity and (len(names) == 1 or quantity in _RANGES or quantity in CODES)
    ]
    twice = {band.quantity for band in bands if sum(band.quantity == other.quantity for other in bands) > 1}
    if twice:
        raise RasterError(f"{path}: several bands hold {', '.join(sorted(twice))} ({', '.join(names)}); remove one")
    return sorted(bands, key=lambda band: band.quantity == "base_height")


def _band_names(source: Any) -> list[str]:
    """Return the descriptions of the bands, or the list of names in a tag of the file; empty texts for none."""
    from rasterio.enums import ColorInterp

    shown = zip(source.descriptions, source.colorinterp, strict=True)
    names = [text or "" for text, use in shown if use != ColorInterp.alpha]
    if not any(meaning(name) for name in names):
        for text in source.tags().values():
            listed = re.split(r"[;,|]\s*", text)
            if len(listed) == len(names) > 1 and all(meaning(name) for name in listed):
                return listed
    return names


def _stated_unit(source: Any, quantity: str, index: int, name: str) -> str:
    """Return a band's unit by LCP header, unit text, name or scale factor, as in `_FACTORS`. Raises RasterError for a
    header's unit that cannot be converted."""
    if source.driver == "LCP" and quantity in _LCP_UNITS:
        key, units = _LCP_UNITS[quantity]
        code = str(source.tags(index).get(key, ""))
        if code and code not in units:
            raise RasterError(f"{source.name}: {key} of its {quantity} is {code}; use {', '.join(units)}")
        return units.get(code, "")
    text = source.units[index - 1] or ""
    for long, short in _SPELLINGS:
        text = re.sub(long, short, text.lower())
    if quantity == "slope":
        return "percent" if text in ("%", "percent", "pct") or re.search("slp_?p|percent", _words(name)) else ""
    known = _FACTORS.get(quantity, {})
    if text in known:
        return text
    words = [] if quantity == "elevation" else _words(f"{name}_{Path(source.name).stem}").split("_")
    spelled = {"feet": "ft", "meters": "m", "metres": "m"}
    by_name = [unit for word in words if (unit := spelled.get(word, word)) in known and not unit.isdigit()]
    scaled = (source.scales[index - 1], source.offsets[index - 1]) != (1.0, 0.0)
    return by_name[0] if by_name else _PHYSICAL.get(quantity, "") if scaled else ""


def read_band(band: FuelBand, geometry: GridGeometry | None = None, crs: str | None = None) -> Float64Array:
    """Return a band's values (H, W) in its own unit, scaled, NaN for nodata, on its own grid or by nearest cell on
    `geometry`. `crs`: of a file that states none.

    Nodata is what the file declares or masks, and what common programs write without declaring it: values of -1000 and
    below, 32767, 65535 and 1e9 and above, and but for elevation and aspect, negative values and 255 of uint8.
    """
    from rasterio.enums import Resampling
    from rasterio.vrt import WarpedVRT

    with open_raster(band.path) as source:
        dtype = np.dtype(source.dtypes[band.index - 1])
        if dtype.kind not in "iuf":
            raise RasterError(f"{band.place}: values are {dtype}; they must be real numbers")
        if geometry is None:
            check_size(source, band.path, source.height, source.width)
            values = source.read(band.index, masked=True).astype(np.float64).filled(np.nan)
        else:
            if source.crs is None and crs is None:
                raise RasterError(f"{band.path}: the raster has no CRS; give it with `fuel: {{prior: {{crs: ...}}}}`")
            options: dict[str, Any] = {} if source.crs is not None else {"src_crs": crs}
            with WarpedVRT(
                source,
                crs=geometry.crs,
                transform=geometry.transform(),
                width=geometry.width,
                height=geometry.height,
                resampling=Resampling.nearest,
                nodata=np.nan,
                tolerance=0.001,
                dtype="float64",
                **options,
            ) as warped:
                values = warped.read(band.index)
        scale, offset = source.scales[band.index - 1], source.offsets[band.index - 1]
        declared = source.nodatavals[band.index - 1]
    # The warper takes a cell for nodata only if all of its bands are.
    unknown = ~np.isfinite(values) | (values <= -1000) | np.isin(values, (32767, 65535, declared)) | (values >= 1e9)
    if band.quantity not in ("elevation", "aspect"):
        unknown |= (values < 0) | ((dtype == np.uint8) & (values == 255))
    return np.where(unknown, np.nan, values * scale + offset)


def in_landfire_units(read: Iterable[tuple[FuelBand, Float64Array]]) -> tuple[dict[str, Int16Array], list[str]]:
    """Return bands (H, W) by quantity in LANDFIRE's units, NODATA where unknown, and remarks about what was converted
    or dropped. Raises RasterError for values that the quantity cannot have in any unit."""
    found: dict[str, Int16Array] = {}
    remarks: list[str] = []
    length = ""
    for band, values in read:
        unit = band.unit or _unit_of_values(band, values, length)
        if band.quantity == "height":
            length = unit
        turned = _converted(band, values, unit)
        if unit != band.unit and unit not in ("", "%", "mx10", "kg/m3x100"):
            remarks.append(f"{band.place}: read as {unit} by its values")
        if band.quantity in CODES and (turned != np.round(turned))[np.isfinite(turned)].any():
            raise RasterError(f"{band.place}: holds fractions; resample codes by nearest cell (gdalwarp -r near)")
        low, high = _RANGES.get(band.quantity, (0, 32767))
        out = (turned < low) | (turned > high)
        if out.any():
            strange = f"{int(out.sum())} cells hold values outside {low:g} to {high:g} such as {turned[out][0]:g}"
            if out.sum() > _STRAY * np.isfinite(turned).sum():
                raise RasterError(
                    f"{band.place}: {strange}; if it holds something else, name it in the band's description (FBFM40, "
                    f"CC, CH, CBH, CBD), otherwise {STATE_UNIT}"
                )
            remarks.append(f"{band.place}: {strange}; they are unknown")
        keep = np.isfinite(turned) & ~out
        found[band.quantity] = np.where(keep, np.round(np.where(keep, turned, 0)), NODATA).astype(np.int16)
    _check_crown_base(found)
    return found, remarks


def _unit_of_values(band: FuelBand, values: Float64Array, length: str) -> str:
    """Return the unit that the values show, empty for LANDFIRE's. `length`: of the canopy height beside a base height.
    Raises RasterError where they show none."""
    some = values[values > 0]
    if some.size == 0 or band.quantity not in _PHYSICAL:
        return ""
    most, whole = float(some.max()), bool((np.abs(some - np.round(some)) < 1e-3).all())
    if band.quantity == "cover":
        if whole and 1 < most <= len(_CLASSES) - 1:
            return "class"
        if whole and most == 1:
            raise RasterError(f"{band.place}: holds only 0 and 1, as %, as a fraction or as a class; {STATE_UNIT}")
        # Fuel codes, of which a landscape may hold any in the wrong band, lie between.
        evc = whole and (most > 204 or (most > 100 and some.min() < 91))
        return "evc" if evc else "fraction" if most <= 1 else ""
    if band.quantity == "bulk_density":
        return "" if whole or most > 2 else "kg/m3"
    if not whole:
        return "m" if most <= (120 if band.quantity == "height" else 30) else ""
    if band.quantity == "base_height":
        return length if most <= 30 else ""
    if most <= 60 and (some % 5 != 0).any():
        raise RasterError(f"{band.place}: heights up to {most:g} are m or m x 10; {STATE_UNIT}")
    return ""


def _converted(band: FuelBand, values: Float64Array, unit: str) -> Float64Array:
    if unit == "class":
        index = np.where(np.isfinite(values) & (values < len(_CLASSES)), values, 0).astype(np.int64)
        return np.where(np.isfinite(values), np.where(values == 99, 0.0, _CLASSES[index]), np.nan)
    if unit == "evc":
        return _tree_cover(band, values)
    if unit == "percent" and band.quantity == "slope":
        return np.asarray(np.degrees(np.arctan(values / 100)))
    return values * _FACTORS.get(band.quantity, {}).get(unit, 1.0)


def _tree_cover(band: FuelBand, values: Float64Array) -> Float64Array:
    """Return the tree cover in % of LANDFIRE's existing vegetation cover: 101 to 199 are trees with 1 to 99 %, and
    until 2016 101 to 109 trees with 10 to 99 % in tenths. Other cover has no trees."""
    most = float(np.nanmax(values))
    if most > 399:
        raise RasterError(f"{band.place}: holds values up to {most:g}; a canopy cover is 0 to 100 %")
    trees = (values > 100) & (values < (200 if most > 129 else 110))
    cover = values - 100 if most > 129 else 10 * (values - 100) + 5
    return np.where(np.isnan(values), np.nan, np.where(trees, np.minimum(cover, 100), 0.0))


def _check_crown_base(bands: Mapping[str, Int16Array]) -> None:
    """Raise RasterError if the crown bases of most stands are above their tops: units or bands are mixed up."""
    if not {"height", "base_height"} <= bands.keys():
        return
    top, base = bands["height"], bands["base_height"]
    both = (top > 0) & (base > 0)
    above = int((both & (base > top)).sum())
    if 2 * above > both.sum():
        raise RasterError(
            f"canopy base height is above canopy height in {above} of {int(both.sum())} cells: bands or units are "
            f"mixed up; name the bands CH and CBH, and {STATE_UNIT}"
        )
