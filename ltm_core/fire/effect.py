"""Compare fires on the previous and the updated map and on drawn ones, and read and write their rasters.

A draw takes the shares of life forms in each cell from their Dirichlet distribution (`docs/how/fuel.md`). Neighbouring
cells are correlated by a Gaussian copula of a smooth field, as wide as the map's context, and an independent one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy import ndimage
from scipy.special import gammaincinv, ndtr

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int16Array
from ltm_core.fire.pyretechnics import FireRun
from ltm_core.fuel.band_values_io import in_landfire_units, read_quantity
from ltm_core.fuel.codes import FuelClimate, FuelSystem, system_of_codes
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.export.landscape import LANDSCAPE_BANDS, Landscape
from ltm_core.fuel.export.landscape_io import write_raster
from ltm_core.fuel.fuel_bands_io import CODES, POSITIONS, FuelBand, file_bands
from ltm_core.fuel.life_form import FORMS, NODATA, LifeForm, forms_of, held
from ltm_core.geometry.geodesy import MOST_EXPORTED, map_problem, read_crs, same_crs, scale_problem
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import open_raster

USUAL_HOURS = (1.0, 3.0, 6.0)


@dataclass(frozen=True)
class Area:
    """Burned area in hectares some hours after ignition; `ensemble`: lowest, median and highest of the draws without
    the outermost tenths, None without one."""

    hours: float
    before: float
    after: float
    ensemble: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class FireEffect:
    """Comparison of two fires. `changed`: (H, W) cells with different fuel or canopy. `probability`: (H, W) share of
    the drawn landscapes on which a cell burns; None: none was drawn."""

    before: FireRun
    after: FireRun
    changed: BoolArray
    cell: float
    hours: float
    probability: Float32Array | None = None
    members: tuple[tuple[float, ...], ...] = ()
    """Burned area of each draw in hectares at the hours of `hours_shown`."""

    def difference(self) -> Float32Array:
        """Return (H, W) hours by which the fire arrives later on the updated map; NaN unless it arrives on both."""
        return self.after.arrival - self.before.arrival

    def flame_difference(self) -> Float32Array:
        """Return (H, W) metres by which flames are longer on the updated map; NaN unless the fire arrives on both."""
        both = self.before.burned & self.after.burned
        return np.where(both, self.after.flame - self.before.flame, np.float32(np.nan))

    def hours_shown(self) -> tuple[float, ...]:
        return tuple(sorted({h for h in USUAL_HOURS if h < self.hours} | {self.hours}))

    def areas(self) -> list[Area]:
        rows = []
        for k, hours in enumerate(self.hours_shown()):
            spread = None
            if self.members:
                low, middle, high = np.quantile([member[k] for member in self.members], (0.1, 0.5, 0.9))
                spread = float(low), float(middle), float(high)
            rows.append(Area(hours, self._hectares(self.before, hours), self._hectares(self.after, hours), spread))
        return rows

    def first_contact(self) -> float | None:
        """Return hours until a fire, on the previous or the updated map, reaches a changed cell; None: never. Cells
        that no longer burn count by the previous map."""
        there = np.concatenate([run.arrival[self.changed & run.burned] for run in (self.before, self.after)])
        return float(there.min()) if there.size else None

    def _hectares(self, run: FireRun, hours: float) -> float:
        return hectares(run, hours, self.cell)


def hectares(run: FireRun, hours: float, cell: float) -> float:
    return float(run.burned_by(hours).sum() * cell**2 / 1e4)


def changed_fuel(before: Landscape, after: Landscape) -> BoolArray:
    """Return (H, W) cells with a different fuel model or canopy band. Raises RasterError for different grids."""
    if before.geometry.shape != after.geometry.shape:
        raise RasterError(f"landscapes of {before.geometry.shape} and {after.geometry.shape} cells cannot be compared")
    return np.asarray((before.bands[3:] != after.bands[3:]).any(axis=0))


def burn_probability(runs: Sequence[FireRun]) -> Float32Array:
    """Return (H, W) the share of the fires that reach a cell."""
    return np.asarray(np.mean([run.burned for run in runs], axis=0), np.float32)


_USUAL_STAND: Final = 0.4
"""Correlation of two observations of cells of a stand if none was measured."""
_RARE: Final = (LifeForm.BARE, LifeForm.WATER, LifeForm.BUILT, LifeForm.BURNED)
"""Life forms that are drawn only if a camera has seen them, because prior maps rarely miss lakes. Bare ground drawn
wherever the prior may err would break up the fuel of all unseen cells."""
_SHOWN: Final = 1.0
"""Evidence above which a life form counts as seen."""


@dataclass(frozen=True, eq=False)
class CellDoubt:
    """Uncertainty of each cell. `alpha`: (H, W, FORMS) of the Dirichlet distribution of its life forms, prior and
    evidence together. `prior`, `code`: (H, W) fuel codes before and now. `fixed`: (H, W) cells that no draw changes."""

    alpha: Float64Array
    prior: Int16Array
    code: Int16Array
    fixed: BoolArray

    @classmethod
    def of(cls, layers: FuelLayers, alpha: Float64Array, mask: tuple[int, ...]) -> CellDoubt:
        """Return the uncertainty of a map; `mask`: codes that labels never change (`FusionRules.mask`)."""
        fixed = held(layers.prior, mask) | (layers.code == NODATA)
        return cls(alpha, layers.prior, layers.code, fixed)


def drawn_codes(
    doubt: CellDoubt,
    climate: FuelClimate,
    system: FuelSystem,
    rng: np.random.Generator,
    width: float = 3.0,
    stand: float | None = None,
) -> Int16Array:
    """Return (H, W) the codes of one draw. `width`: cells, of the smooth field; `stand`: its share of the variance."""
    shared = _USUAL_STAND if stand is None else stand
    agreeing = forms_of(doubt.prior)
    prior = np.where(agreeing, doubt.alpha, 0.0).sum(axis=-1)
    has_prior = agreeing.any(axis=-1)
    best = np.where(has_prior, _gamma(prior, rng, width, shared), -1.0)
    form = np.full(doubt.prior.shape, -1)
    for k in range(FORMS):
        alpha = np.where(agreeing[..., k] & has_prior, 0.0, doubt.alpha[..., k])
        if LifeForm(k + 1) in _RARE:
            alpha = np.where(alpha >= _SHOWN, alpha, 0.0)
        drawn = _gamma(alpha, rng, width, shared)
        larger = (alpha > 0) & (drawn > best)
        best, form = np.where(larger, drawn, best), np.where(larger, k, form)
    over_shrubs = agreeing[..., LifeForm.SHRUB - 1]
    codes = np.where(form < 0, doubt.prior, getattr(climate.changed, system).of(form, over_shrubs))
    # Where the draw is of what the map says anyway, its own code of that form: a mixture, or what grew after a burn.
    own = forms_of(doubt.code)
    rows, cols = np.indices(form.shape)
    same = (form >= 0) & own[rows, cols, np.maximum(form, 0)]
    codes = np.where(same | doubt.fixed, doubt.code, codes)
    return codes.astype(np.int16)


def with_codes(layers: FuelLayers, codes: Int16Array) -> FuelLayers:
    """Return the layers with other codes."""
    return replace(layers, code=codes)


def _gamma(alpha: Float64Array, rng: np.random.Generator, width: float, shared: float) -> Float64Array:
    """Return (H, W) gamma variates of shapes `alpha`, correlated between neighbours; 0 where the shape is 0."""
    smooth = ndimage.gaussian_filter(rng.standard_normal(alpha.shape), width, mode="wrap")
    smooth /= _smoothed_deviation(alpha.shape, width)
    field = np.sqrt(shared) * smooth + np.sqrt(1 - shared) * rng.standard_normal(alpha.shape)
    share = np.clip(ndtr(field), 1e-9, 1 - 1e-9)
    result = np.zeros(alpha.shape)
    some = alpha > 0
    result[some] = gammaincinv(alpha[some], share[some])
    return result


@lru_cache(maxsize=4)
def _smoothed_deviation(shape: tuple[int, ...], width: float) -> float:
    """Return what the filter leaves of a deviation of 1: its weights, squared and summed, are the variance that is
    left."""
    impulse = np.zeros(shape)
    impulse[0, 0] = 1.0
    return float(np.sqrt((ndimage.gaussian_filter(impulse, width, mode="wrap") ** 2).sum()))


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
