"""Find out what the bands of terrain, fuel and canopy files hold, and in which units.

Attribute tables, band descriptions and file names decide; positions count only in a landscape that names no band."""

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from ltm_core.base.errors import RasterError
from ltm_core.raster.raster_io import open_raster
from ltm_core.storage.disk_io import is_file

CODES: Final = ("fbfm40", "fbfm13", "codes")
_REVISION = r"(?P<revision>[a-z][0-9]{0,3})?"
_WORDS: Final[Mapping[str, str]] = {
    "fbfm40": rf"[0-9]*fbfm_?40{_REVISION}|[0-9]*f40|fm_?40|sb_?40|scott_(and_)?burgan(_?40)?|fuel_models?_?40",
    "fbfm13": rf"[0-9]*fbfm_?13{_REVISION}|[0-9]*f13|fm_?13|anderson(_?13)?|fuel_models?_?13",
    "cover": r"[0-9]*cc|(canopy|crown|tree)_(cover|closure)",
    "height": r"[0-9]*ch|(canopy|crown|stand|tree)_(height|ht)",
    "base_height": r"[0-9]*cbh|((canopy|crown)_)?base_(height|ht)",
    "bulk_density": r"[0-9]*cbd|((canopy|crown)_)?bulk_density",
    "elevation": r"[0-9]*(dem|elev)[0-9]*|elevation",
    "slope": r"[0-9]*slp(_?[dp])?[0-9]*|slope",
    "aspect": r"[0-9]*asp[0-9]*|aspect",
    "vegetation": r"[0-9]*(evt|evc|evh|fvt|fvc|fvh|bps|nvc|fccs)",
    "other": r"duff|woody|adj|phi|ws|wd|m1|m10|m100|mlh|mlw",
}
"""Words that identify a band between characters that are neither letters nor digits: CC, LC22_CC_230 (LANDFIRE),
US_200FBFM40 (its older downloads), fbfm40r5 (ELMFIRE), CanopyBaseHeight. `other` are further inputs of fire models."""
_ALONE: Final[Mapping[str, str]] = {
    "codes": r"(surface_)?fuels?(_(models?|codes?))?|fbfm",
    "cover": "cover", "height": "height", "base_height": "base", "bulk_density": "density",
}  # fmt: skip
"""Words that identify a band only if nothing but numbers stands beside them."""
POSITIONS: Final = ("elevation", "slope", "aspect", "codes", "cover", "height", "base_height", "bulk_density")
_GROUND: Final = ("other", "other")
_LAYOUTS: Final = {5: POSITIONS[:5], 7: (*POSITIONS[:5], *_GROUND), 8: POSITIONS, 10: (*POSITIONS, *_GROUND)}
_LENGTHS: Final = {"m": 10.0, "ft": 3.048, "mx10": 1.0, "dm": 1.0, "ftx10": 0.3048, "cm": 0.1}
FACTORS: Final[Mapping[str, Mapping[str, float]]] = {
    "elevation": {"m": 1.0, "ft": 0.3048, "dm": 0.1, "cm": 0.01},
    "cover": {"%": 1.0, "percent": 1.0, "pct": 1.0, "1": 100.0, "fraction": 100.0},
    "height": _LENGTHS,
    "base_height": _LENGTHS,
    "bulk_density": {"kg/m3": 100.0, "kg/m3x100": 1.0, "lb/ft3": 1601.846, "lb/ft3x1000": 1.601846},
}
"""Factors from a stated unit to LANDFIRE's: m, %, m x 10, kg/m3 x 100."""
_SPELLINGS: Final = (
    (r"us.?survey|international|\*\*|[\s^()]", ""), ("met(er|re)s?", "m"), ("feet|foot", "ft"), ("kgm-3", "kg/m3"),
    (r"\*", "x"),
)  # fmt: skip
PHYSICAL: Final = {"cover": "%", "height": "m", "base_height": "m", "bulk_density": "kg/m3"}
"""Units of values with a scale factor, if no other is stated."""
_LCP_UNITS: Final[Mapping[str, tuple[str, Mapping[str, str]]]] = {
    "elevation": ("ELEVATION_UNIT", {"0": "m", "1": "ft"}),
    "slope": ("SLOPE_UNIT", {"0": "degrees", "1": "percent"}),
    "aspect": ("ASPECT_UNIT", {"0": "class", "1": "counterclockwise", "2": ""}),
    "codes": ("FUEL_MODEL_OPTION", {"0": "code", "1": "code"}),
    "cover": ("CANOPY_COV_UNIT", {"0": "class", "1": "%"}),
    "height": ("CANOPY_HT_UNIT", {"1": "m", "2": "ft", "3": "mx10", "4": "ftx10"}),
    "base_height": ("CBH_UNIT", {"1": "m", "2": "ft", "3": "mx10", "4": "ftx10"}),
    "bulk_density": ("CBD_UNIT", {"1": "kg/m3", "2": "lb/ft3", "3": "kg/m3x100", "4": "lb/ft3x1000"}),
}
"""Unit codes of LCP headers as GDAL reports them. Codes of fuel options 2 and 3 need a conversion file."""


@dataclass(frozen=True)
class FuelBand:
    """A band and what it holds. `unit`: as stated, empty: unknown. `by_position`: whether no name says what it is."""

    path: Path
    quantity: str
    index: int = 1
    unit: str = ""
    by_position: bool = False

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
    if re.search("(^|_)(fuels?|fbfm)(_|$)", words) and not found.keys() & set(CODES):
        found = {}  # a fuel map of CH, Switzerland
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
    from xml.etree import ElementTree  # here, because it takes 30 ms to load and few rasters have such a table

    table, aux = (path.with_name(f"{path.name}{suffix}") for suffix in (".vat.dbf", ".aux.xml"))
    try:
        if is_file(table):
            with table.open("rb") as file:
                head = file.read(max(0, struct.unpack("<H", file.read(32)[8:10])[0] - 32))
            return [head[k : k + 11].split(b"\0")[0].decode("ascii", "replace") for k in range(0, len(head) - 31, 32)]
        if is_file(aux) and aux.stat().st_size < 1 << 20:
            return [str(node.text) for node in ElementTree.fromstring(aux.read_bytes()).iterfind(".//FieldDefn/Name")]
    except (OSError, ElementTree.ParseError, struct.error):
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
    height last. `default`: quantity of a single band that states none. Names go before positions. Raises RasterError:
    several bands of one quantity, no fuel codes."""
    names = _band_names(source)
    known = [found and found[0] for found in map(meaning, names)]
    layout = _LAYOUTS.get(len(names), ())
    if len(names) == 1:
        known = [quantity_of(path, names[0]) or default or "codes"]
    elif layout and all(k in (None, q) or (k in CODES and q == "codes") for k, q in zip(known, layout, strict=True)):
        known = [k or q for k, q in zip(known, layout, strict=True)]
    elif not set(known) & set(CODES):
        listed = ", ".join(filter(None, names)) or "none"
        raise RasterError(
            f"{path}: none of its {len(names)} bands is named as fuel codes (names: {listed}); a landscape without "
            "names has 5, 7, 8 or 10. Describe the bands as Elev, Slp, Asp, FBFM40, CC, CH, CBH, CBD"
        )
    unnamed = len(names) > 1 and source.driver != "LCP"
    bands = [
        FuelBand(path, kind, k, _stated_unit(source, kind, k, name), unnamed and not meaning(name))
        for k, (kind, name) in enumerate(zip(known, names, strict=True), start=1)
        if kind and (len(names) == 1 or kind in CODES or kind in POSITIONS)
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
    """Return a band's unit by LCP header, unit text, name or scale factor, as in `FACTORS`. Raises RasterError for a
    header's unit that cannot be converted."""
    key, units = _LCP_UNITS.get("codes" if quantity in CODES else quantity, ("", {}))
    if code := source.tags(index).get(key):  # a GeoTIFF that GDAL made of an LCP has it too
        if code not in units:
            raise RasterError(f"{source.name}: {key} of its {quantity} is {code}; use {', '.join(units)}")
        return units[code]
    text = source.units[index - 1] or "".join(re.findall(r"[(\[](.*)[)\]]", name))
    for long, short in _SPELLINGS:
        text = re.sub(long, short, text.lower())
    if quantity == "slope":
        return "percent" if text in FACTORS["cover"] or re.search("slp_?p|percent", _words(name)) else ""
    if text in FACTORS.get(quantity, {}):
        return text
    scaled = (source.scales[index - 1], source.offsets[index - 1]) != (1.0, 0.0)
    return PHYSICAL.get(quantity, "") if scaled else ""
