"""Read bands of terrain, fuel and canopy in LANDFIRE's units: nodata, the unit that values show, implausible values."""

from collections.abc import Iterable, Mapping
from typing import Any, Final

import numpy as np

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Float64Array, Int16Array
from ltm_core.fuel.fuel_bands_io import CODES, FACTORS, PHYSICAL, FuelBand
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import check_size, open_raster, read_band

_RANGES: Final[Mapping[str, tuple[float, float]]] = {
    "elevation": (-500, 9000), "slope": (0, 90), "aspect": (-1, 360),
    "cover": (0, 100), "height": (0, 1200), "base_height": (0, 1000), "bulk_density": (0, 300),
}  # fmt: skip
"""Plausible values in LANDFIRE's units."""
_CLASSES: Final = np.array([0.0, 10.0, 35.0, 65.0, 90.0])
"""Cover in % of FARSITE's classes 0 to 4: none, 1 to 20, 21 to 50, 51 to 80 and 81 to 100 %."""
_STRAY: Final = 0.01
"""Maximum share of cells with implausible values, which become unknown; a band with more is rejected."""
_NAME_IT: Final = "describe its bands as Elev, Slp, Asp, FBFM40, CC, CH, CBH, CBD"
_STATE_UNIT: Final = "state its unit in the file, such as `rio edit-info --bidx 1 --units m FILE`"


def read_quantity(band: FuelBand, geometry: GridGeometry | None = None, crs: str | None = None) -> Float64Array:
    """Return a band's values (H, W) in its own unit, scaled, NaN for nodata, on its own grid or by nearest cell on
    `geometry`. `crs`: of a file that states none. Nodata is what the file declares or masks, and what common programs
    write without declaring it: values of -1000 and below, 32767, 65535 and 1e9 and above, and but for elevation and
    aspect, negative values and 255 of uint8."""
    from rasterio.enums import Resampling
    from rasterio.vrt import WarpedVRT

    with open_raster(band.path) as source:
        dtype = np.dtype(source.dtypes[band.index - 1])
        if dtype.kind not in "iuf":
            raise RasterError(f"{band.place}: values are {dtype}; they must be real numbers")
        if geometry is None:
            check_size(source, band.path, source.height, source.width)
            stored, masked = read_band(source, band.index)
            values = np.where(masked, np.nan, stored.astype(np.float64))
        else:
            if source.crs is None and crs is None:
                raise RasterError(f"{band.path}: the raster has no CRS; give it with `fuel: {{prior: {{crs: ...}}}}`")
            options: dict[str, Any] = {} if source.crs is not None else {"src_crs": crs}
            options |= {"width": geometry.width, "height": geometry.height, "tolerance": 0.001, "dtype": "float64"}
            # With src_nodata, GDAL ignores a mask; declared values are removed below.
            options |= {"nodata": np.nan, "src_nodata": None, "resampling": Resampling.nearest}
            with WarpedVRT(source, crs=geometry.crs, transform=geometry.transform(), **options) as warped:
                values = warped.read(band.index)
        scale, offset = source.scales[band.index - 1], source.offsets[band.index - 1]
        declared = np.nan if (nodata := source.nodatavals[band.index - 1]) is None else nodata
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
        if band.by_position and band.quantity == "codes" and (turned == 0).any():
            raise RasterError(f"{band.place}: holds 0, which is no fuel code, in a file without names; {_NAME_IT}")
        low, high = _RANGES.get(band.quantity, (0, 32767))
        out = (turned < low) | (turned > high)
        if out.any():
            strange = f"{int(out.sum())} cells hold values outside {low:g} to {high:g} such as {turned[out][0]:g}"
            if out.sum() > _STRAY * np.isfinite(turned).sum():
                raise RasterError(
                    f"{band.place}: {strange}; if it holds something else, {_NAME_IT}, otherwise {_STATE_UNIT}"
                )
            remarks.append(f"{band.place}: {strange}; they are unknown")
        keep = np.isfinite(turned) & ~out
        found[band.quantity] = np.where(keep, np.round(np.where(keep, turned, 0)), NODATA).astype(np.int16)
    if {"height", "base_height"} <= found.keys():
        top, base = found["height"], found["base_height"]
        both = (top > 0) & (base > 0)
        above = int((both & (base > top)).sum())
        if 2 * above > both.sum():
            raise RasterError(
                f"canopy base height is above canopy height in {above} of {int(both.sum())} cells: bands or units are "
                f"mixed up; name the bands CH and CBH, and {_STATE_UNIT}"
            )
    return found, remarks


def _unit_of_values(band: FuelBand, values: Float64Array, length: str) -> str:
    """Return the unit that the values show, empty for LANDFIRE's. `length`: of the canopy height beside a base height.
    Raises RasterError where they show none."""
    some = values[values > 0]
    if some.size == 0 or band.quantity not in PHYSICAL:
        return ""
    most, whole = float(some.max()), bool((np.abs(some - np.round(some)) < 1e-3).all())
    if band.quantity == "cover":
        if whole and 1 < most <= len(_CLASSES) - 1:
            return "class"
        if whole and most == 1:
            raise RasterError(f"{band.place}: holds only 0 and 1, as %, as a fraction or as a class; {_STATE_UNIT}")
        # Fuel codes, of which a landscape may hold any in the wrong band, lie between.
        evc = whole and (some > 100).mean() > 0.25 and (most > 204 or some.min() < 91)
        return "evc" if evc else "fraction" if most <= 1 else ""
    if band.quantity == "bulk_density":
        return "" if whole or most > 2 else "kg/m3"
    if not whole:
        return "m" if most <= (120 if band.quantity == "height" else 30) else ""
    if band.quantity == "base_height":
        return length if most <= 30 else ""
    if most <= 60 and (some % 5 != 0).any():
        raise RasterError(f"{band.place}: heights up to {most:g} are m or m x 10; {_STATE_UNIT}")
    return ""


def _converted(band: FuelBand, values: Float64Array, unit: str) -> Float64Array:
    if unit == "class" and band.quantity == "cover":  # headers state it of % too
        plain = np.where(np.isnan(values) | (values == 99), 0, values)
        classes = _CLASSES[plain.astype(np.int64)] if plain.max() < len(_CLASSES) else plain
        return np.where(np.isnan(values), np.nan, classes)
    if unit == "evc":
        # LANDFIRE's existing vegetation cover: 101 to 199 are trees with 1 to 99 %, and until 2016 101 to 109 trees
        # with 10 to 99 % in tenths. Other cover has no trees.
        most = float(np.nanmax(values))
        if most > 399:
            raise RasterError(f"{band.place}: holds values up to {most:g}; a canopy cover is 0 to 100 %")
        cover, trees = (values - 100, 200) if most > 129 else (10 * (values - 100) + 5, 110)
        shown = np.where((values > 100) & (values < trees), np.minimum(cover, 100), 0.0)
        return np.where(np.isnan(values), np.nan, shown)
    if unit == "percent" and band.quantity == "slope":
        return np.asarray(np.degrees(np.arctan(values / 100)))
    return values * FACTORS.get(band.quantity, {}).get(unit, 1.0)
