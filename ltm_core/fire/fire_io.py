"""Read landscapes for a fire and write fires as GeoTIFF."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.fire.effect import FireEffect
from ltm_core.fuel.codes import system_of_codes
from ltm_core.fuel.export.landscape import LANDSCAPE_BANDS, Landscape
from ltm_core.fuel.export.landscape_io import write_raster
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import check_size, open_raster

_NODATA_VALUES: Final = (-9999, 32767)
_LCP_UNITS: Final[Mapping[str, str]] = {
    "ELEVATION_UNIT": "0", "SLOPE_UNIT": "0", "ASPECT_UNIT": "2", "CANOPY_HT_UNIT": "3", "CBH_UNIT": "3",
    "CBD_UNIT": "3",
}  # fmt: skip
"""Units of the LCP header as reported by GDAL: m, degrees, azimuth, m x 10, m x 10, kg/m3 x 100."""


def read_landscape(path: Path) -> Landscape:
    """Read a landscape. Raises RasterError for a file without the eight bands, a metric CRS, square cells or LANDFIRE's
    units."""
    with open_raster(path) as source:
        if source.count < len(LANDSCAPE_BANDS):
            raise RasterError(
                f"{path}: has {source.count} bands; a fire needs a landscape of {len(LANDSCAPE_BANDS)}: write one with "
                "`ltm export --format landscape` or `--format lcp`"
            )
        t = source.transform
        if t.b or t.d or t.a <= 0 or abs(t.a + t.e) > 1e-6 * t.a:
            raise RasterError(f"{path}: a landscape is north-up with square cells, this has {tuple(t)[:6]}")
        if source.crs is None or not source.crs.is_projected:
            raise RasterError(
                f"{path}: the CRS is {source.crs or 'missing'}; a fire needs a projected CRS in metres: export "
                "it again with "
                "`ltm export --crs EPSG:...`, and keep the .prj beside an LCP"
            )
        _check_units(source, path)
        check_size(source, path, source.height, source.width)
        geometry = GridGeometry(t.c, t.f, t.a, source.width, source.height, source.crs.to_wkt())
        bands = np.empty((len(LANDSCAPE_BANDS), source.height, source.width), np.int16)
        for number, band in enumerate(bands, start=1):  # one after the other: whole numbers need room
            values = source.read(number).astype(np.int64)
            unknown = np.isin(values, _NODATA_VALUES) | (np.abs(values) > 32767)
            if source.nodata is not None:
                unknown |= values == source.nodata
            band[:] = np.where(unknown, NODATA, values)
    return Landscape(bands, geometry, system_of_codes(bands[LANDSCAPE_BANDS.index("fuel")]))


def require_same_grid(before: Landscape, after: Landscape, names: tuple[str, str]) -> None:
    """Raise ConfigError unless both are on one grid."""
    from pyproj import CRS

    a, b = before.geometry, after.geometry
    if CRS(a.crs) != CRS(b.crs):
        raise ConfigError(
            f"{names[0]} is in {CRS(a.crs).name}, {names[1]} in {CRS(b.crs).name}: cells cannot be compared; export "
            "both into one CRS with `ltm export --crs`"
        )
    same = (a.x_min, a.y_max, a.resolution, a.shape) == (b.x_min, b.y_max, b.resolution, b.shape)
    if not same:
        raise ConfigError(
            f"{names[0]} has {a.described()}, {names[1]} {b.described()}: export both of the same site, so that they "
            "have one grid"
        )


def _check_units(source: Any, path: Path) -> None:
    if source.driver != "LCP":
        return
    told: dict[str, str] = {}
    for band in range(1, len(LANDSCAPE_BANDS) + 1):
        told |= source.tags(band)
    wrong = [f"{name} {told[name]}" for name, unit in _LCP_UNITS.items() if told.get(name, unit) != unit]
    if wrong:
        raise RasterError(
            f"{path}: the header has units other than LANDFIRE's ({', '.join(wrong)}); write it again with elevation "
            "in m, slope in degrees, heights in m x 10 and density in kg/m3 x 100"
        )


BANDS: Mapping[str, str] = {
    "arrival_before": "hours after ignition",
    "arrival_after": "hours after ignition",
    "arrival_difference": "hours, positive: later on the updated map",
    "flame_before": "m",
    "flame_after": "m",
    "flame_difference": "m, positive: longer on the updated map",
    "changed": "0 no, 1 yes",
    "burn_probability": "1",
}
"""Name and unit of each band; the last one exists only for ensembles."""


def write_fire(path: Path, effect: FireEffect, geometry: GridGeometry, tags: Mapping[str, str]) -> None:
    """Write one GeoTIFF of float32 bands, NaN where the fire does not arrive. Raises ConfigError if it cannot be
    written."""
    layers = [
        effect.before.arrival,
        effect.after.arrival,
        effect.difference(),
        np.where(effect.before.burned, effect.before.flame, np.nan),
        np.where(effect.after.burned, effect.after.flame, np.nan),
        effect.flame_difference(),
        effect.changed,
    ]
    if effect.probability is not None:
        layers.append(effect.probability)
    count = len(layers)
    array = np.stack([np.asarray(layer, np.float32) for layer in layers])
    names, units = tuple(BANDS)[:count], tuple(BANDS.values())[:count]
    write_raster(path, array, geometry, float("nan"), names, units, tags=tags)
