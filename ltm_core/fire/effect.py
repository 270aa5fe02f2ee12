"""Compare fires on the previous and the updated map, and read and write their rasters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.base.types import BoolArray, Float32Array
from ltm_core.fire.pyretechnics import FireRun
from ltm_core.fuel.band_values_io import in_landfire_units, read_quantity
from ltm_core.fuel.codes import system_of_codes
from ltm_core.fuel.export.landscape import LANDSCAPE_BANDS, Landscape
from ltm_core.fuel.export.landscape_io import write_raster
from ltm_core.fuel.fuel_bands_io import CODES, POSITIONS, FuelBand, file_bands
from ltm_core.geometry.geodesy import MOST_EXPORTED, map_problem, read_crs, same_crs, scale_problem
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import open_raster

USUAL_HOURS = (1.0, 3.0, 6.0)


@dataclass(frozen=True)
class Area:
    """Burned area in hectares some hours after ignition."""

    hours: float
    before: float
    after: float


@dataclass(frozen=True, eq=False)
class FireEffect:
    """Comparison of two fires. `changed`: (H, W) cells with different fuel or canopy."""

    before: FireRun
    after: FireRun
    changed: BoolArray
    cell: float
    hours: float

    def difference(self) -> Float32Array:
        """Return (H, W) hours by which the fire arrives later on the updated map; NaN unless it arrives on both."""
        return self.after.arrival - self.before.arrival

    def flame_difference(self) -> Float32Array:
        """Return (H, W) metres by which flames are longer on the updated map; NaN unless the fire arrives on both."""
        both = self.before.burned & self.after.burned
        return np.where(both, self.after.flame - self.before.flame, np.float32(np.nan))

    def areas(self) -> list[Area]:
        hours = sorted({h for h in USUAL_HOURS if h < self.hours} | {self.hours})
        return [Area(h, self._hectares(self.before, h), self._hectares(self.after, h)) for h in hours]

    def first_contact(self) -> float | None:
        """Return hours until a fire, on the previous or the updated map, reaches a changed cell; None: never. Cells
        that no longer burn count by the previous map."""
        there = np.concatenate([run.arrival[self.changed & run.burned] for run in (self.before, self.after)])
        return float(there.min()) if there.size else None

    def _hectares(self, run: FireRun, hours: float) -> float:
        return float(run.burned_by(hours).sum() * self.cell**2 / 1e4)


def changed_fuel(before: Landscape, after: Landscape) -> BoolArray:
    """Return (H, W) cells with a different fuel model or canopy band. Raises RasterError for different grids."""
    if before.geometry.shape != after.geometry.shape:
        raise RasterError(f"landscapes of {before.geometry.shape} and {after.geometry.shape} cells cannot be compared")
    return np.asarray((before.bands[3:] != after.bands[3:]).any(axis=0))


def read_landscape(path: Path) -> Landscape:
    """Read a landscape. Raises RasterError for a file without the eight bands, a metric CRS or square cells."""
    with open_raster(path) as source:
        bands = {"codes" if band.quantity in CODES else band.quantity: band for band in _without_fbfm13(source, path)}
        missing = [name for name in POSITIONS if name not in bands]
        if missing:
            raise RasterError(
                f"{path}: has no {', '.join(missing)}; a fire needs a landscape of {len(LANDSCAPE_BANDS)} bands: write "
                "one with `ltm export --format landscape` or `--format lcp`"
            )
        if bands["aspect"].unit:
            raise RasterError(f"{path}: its aspects are {bands['aspect'].unit}; write it again with azimuths")
        t = source.transform
        if t.b or t.d or t.a <= 0 or abs(t.a + t.e) > 1e-6 * t.a:
            raise RasterError(f"{path}: a landscape is north-up with square cells, this has {tuple(t)[:6]}")
        if source.crs is None or not source.crs.is_projected:
            raise RasterError(
                f"{path}: the CRS is {source.crs or 'missing'}; a fire needs a projected CRS in metres: export "
                "it again with "
                "`ltm export --crs EPSG:...`, and keep the .prj beside an LCP"
            )
        geometry = GridGeometry(t.c, t.f, t.a, source.width, source.height, source.crs.to_wkt())
        problem = map_problem(read_crs(source.crs)) or scale_problem(source.crs, geometry, MOST_EXPORTED)
        if problem is not None:
            raise RasterError(f"{path}: {problem}")
    read, _ = in_landfire_units((band, read_quantity(band)) for band in bands.values())
    codes = read.pop(bands["codes"].quantity)
    stack = np.stack([codes if name == "codes" else read[name] for name in POSITIONS])
    return Landscape(stack, geometry, system_of_codes(codes))


def _without_fbfm13(source: Any, path: Path) -> list[FuelBand]:
    """Return the bands of a landscape, of two fuel maps that of FBFM40."""
    bands = file_bands(source, path)
    both = {"fbfm40", "fbfm13"} <= {band.quantity for band in bands}
    return [band for band in bands if not (both and band.quantity == "fbfm13")]


def require_same_grid(before: Landscape, after: Landscape, names: tuple[str, str]) -> None:
    """Raise ConfigError unless both are on one grid."""
    a, b = before.geometry, after.geometry
    if not same_crs(a.crs, b.crs):
        raise ConfigError(
            f"{names[0]} is in {read_crs(a.crs).name}, {names[1]} in {read_crs(b.crs).name}: cells cannot be compared; "
            "export both into one CRS with `ltm export --crs`"
        )
    same = (a.x_min, a.y_max, a.resolution, a.shape) == (b.x_min, b.y_max, b.resolution, b.shape)
    if not same:
        raise ConfigError(
            f"{names[0]} has {a.described()}, {names[1]} {b.described()}: export both of the same site, so that they "
            "have one grid"
        )


BANDS: Mapping[str, str] = {
    "arrival_before": "hours after ignition",
    "arrival_after": "hours after ignition",
    "arrival_difference": "hours, positive: later on the updated map",
    "flame_before": "m",
    "flame_after": "m",
    "flame_difference": "m, positive: longer on the updated map",
    "changed": "fuel or canopy changed: 0 no, 1 yes",
}
"""Name and unit of each band."""


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
    array = np.stack([np.asarray(layer, np.float32) for layer in layers])
    write_raster(path, array, geometry, float("nan"), tuple(BANDS), tuple(BANDS.values()), tags=tags)
