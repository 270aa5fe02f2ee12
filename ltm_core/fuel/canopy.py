"""Estimate the canopy of fuel cells: cover and height by what cameras have seen, then crown base and density.

A confirmed change of the surface gives both from heights over bare earth (if a raster of tree tops says what stood
there before) and from labels (`label_cover`). New trees, and trees without canopy in the prior, get cover from labels
and height from depth against bare earth (`stand_heights`). Other cells keep the canopy of the prior or the climate.

Heights of stands are means weighted by height (Lorey's mean): a terrain cell that shows crowns and gaps has a height
between both, which counts less so."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Float64Array, IndexArray, Int16Array
from ltm_core.fuel.stand_allometry import MOST_DENSITY, ForestType, broadleaved, crown_fuel
from ltm_core.fuel.surface_change import LEAST_SHARE
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.surface.surface_map import SurfaceMap
from ltm_core.surface.surface_versions_io import ConfirmedTerrain

TALL = 2.0
"""Height in metres above which plants are canopy, the height break of airborne surveys of tree cover."""
_ALIKE = 5.0
"""Distance in metres within which heights of a stand are correlated, as smoothed by the surface map."""
_MOST_SAMPLES = 30
"""Maximum number of surface samples per side of a fuel cell."""
_CELLS = 1000
"""Number of fuel cells processed at a time."""


@dataclass(frozen=True, eq=False)
class SeenCanopy:
    """Observed canopy, (H, W) each, NaN where it was not measured. `cover`: %; `height`: mean of the canopy's top over
    bare earth, metres, 0 where no canopy is left."""

    cover: Float32Array
    height: Float32Array


def seen_canopy(terrain: ConfirmedTerrain, grid: GridGeometry) -> SeenCanopy | None:
    """Return the canopy of the cells of a fuel grid (in the map frame) that have changed by at least a quarter; None if
    nothing is confirmed, or if the earlier canopy is unknown."""
    if terrain.surface is None or not terrain.canopy_known:
        return None
    cells = terrain.surface
    row, col = grid.cell_of(*cells.geometry.to_map(cells.rows, cells.cols))
    inside = grid.contains(row, col)
    counts = np.bincount(row[inside] * grid.width + col[inside], minlength=grid.width * grid.height)
    ratio = grid.resolution / cells.geometry.resolution
    chosen = np.flatnonzero(counts >= LEAST_SHARE * ratio**2)
    found = np.full((2, grid.height * grid.width), np.nan, np.float32)
    side = int(np.clip(round(ratio), 1, _MOST_SAMPLES))
    for start in range(0, len(chosen), _CELLS):
        part = chosen[start : start + _CELLS]
        found[:, part] = _measured(terrain.top, terrain.ground, grid, part, side)
    return SeenCanopy(*found.reshape(2, *grid.shape))


def measured_canopy(
    trees: BoolArray,
    new: BoolArray,
    changed: SeenCanopy | None,
    cover: Float64Array | None,
    height: Float32Array | None,
) -> SeenCanopy:
    """Return the measured canopy of the cells with `trees` (H, W): that of the confirmed surface (`changed`); where it
    has not changed, `cover` by labels, % (`EvidenceMap.label_cover`), and `height` of stands, metres (`stand_heights`),
    in cells whose trees are `new` (H, W), or of whose trees the prior has no canopy."""
    unknown = np.full(trees.shape, np.nan, np.float32)
    found = SeenCanopy(unknown, unknown) if changed is None else changed
    use = trees & new & np.isnan(found.cover)
    return SeenCanopy(
        found.cover if cover is None else np.where(use, cover, found.cover).astype(np.float32),
        found.height if height is None else np.where(use, height, found.height),
    )


def with_seen_canopy(
    bands: Int16Array, seen: SeenCanopy, codes: Int16Array, forest: ForestType = ForestType.MIXED_CONIFER
) -> Int16Array:
    """Return canopy bands (4, H, W) of cells with trees, updated by observations: cover and height as measured; crown
    base and bulk density change in proportion to the allometry of such stands (`stand_allometry`). Broadleaved `codes`
    (H, W) and cells without trees do not change."""
    cover, height, base, density = (band.astype(np.float64) for band in bands)
    now = (np.isfinite(seen.cover) | np.isfinite(seen.height)) & (cover > 0) & (height > 0)
    share = np.where(np.isfinite(seen.cover), seen.cover, cover).astype(np.float64)
    tops = np.where(np.isfinite(seen.height), 10.0 * seen.height, height).astype(np.float64)
    was, is_ = (crown_fuel(c, h / 10, forest) for c, h in ((cover, height), (share, tops)))
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.stack([share, tops, base * is_.base / was.base, density * is_.density / was.density])
    stays = broadleaved(codes)
    left = (share > 0) & (tops > 0)
    moved[2:] = np.where(stays, np.where(left, bands[2:], 0), moved[2:])
    moved[2] = np.minimum(moved[2], tops)
    moved[3] = np.minimum(moved[3], np.maximum(density, 100 * MOST_DENSITY))
    return np.where(now & np.isfinite(moved).all(axis=0), np.round(moved), bands).astype(np.int16)


def _measured(top: Dem, ground: Dem, grid: GridGeometry, cells: IndexArray, side: int) -> Float32Array:
    """Return the cover and height (2, N) of cells by their flat places, from side x side points each."""
    rows, cols = np.divmod(cells, grid.width)
    offsets = (np.arange(side) + 0.5) / side - 0.5
    x, y = grid.to_map(rows[:, None, None] + offsets[:, None], cols[:, None, None] + offsets)
    x, y = (points.reshape(len(cells), -1) for points in np.broadcast_arrays(x, y))
    above = top.elevation_at(x, y) - ground.elevation_at(x, y)
    known = np.isfinite(above)
    canopy = known & (above >= TALL)
    stands, points = canopy.sum(axis=1), np.maximum(known.sum(axis=1), 1)
    height = np.where(canopy, above, 0.0).sum(axis=1) / np.maximum(stands, 1)
    found = np.stack([100 * stands / points, height])
    return np.where(known.any(axis=1), found, np.nan).astype(np.float32)


_STRIP = 256
"""Number of terrain rows processed at a time."""
_LEAST_SHARE = 0.1
"""Minimum share of a fuel cell that must have been seen as standing."""
_SEEN_ABOVE = 0.8
"""Ratio of a canopy's mean height from above to its mean height from the side, weighted by height. This and the
following constants were chosen on rendered sites (docs/maps.md)."""
_SAID = 1 / 3
"""Standard error of a height from a prior map, as a share of the height."""


def stand_heights(surface: SurfaceMap, fuel: GridGeometry, before: Float64Array) -> Float32Array:
    """Return, for the cells of a fuel grid (in the map frame), the mean height of objects of 2 m and more over bare
    earth where independent views have measured it, metres; NaN where hardly anything was seen to stand. `before`
    (H, W): heights of an earlier map, metres, combined with the measurement by their standard errors; NaN or too low:
    not used."""
    size = fuel.width * fuel.height
    count, total, squares, cubes, noise = (np.zeros(size) for _ in range(5))
    top, left, height, width = surface.seen_window() or (0, 0, 0, 0)
    for row in range(top, top + height, _STRIP):
        layers = surface.layers((row, left, min(_STRIP, top + height - row), width))
        above = layers.height - layers.bare
        rows, cols = np.nonzero(layers.observed & (above >= TALL))
        to_row, to_col = fuel.cell_of(*layers.geometry.to_map(rows, cols))
        inside = fuel.contains(to_row, to_col)
        place, value = (to_row * fuel.width + to_col)[inside], above[rows, cols][inside].astype(np.float64)
        sigma = layers.sigma[rows, cols][inside].astype(np.float64)
        parts = (count, None), (total, value), (squares, value**2), (cubes, value**3), (noise, value * sigma)
        for sums, part in parts:
            sums += np.bincount(place, part, size)
    ratio = (fuel.resolution / surface.reference.geometry.resolution) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = squares / total
        spread = np.maximum(cubes / total - mean**2, 0.0)
        independent = np.maximum(count / ratio * (fuel.resolution / _ALIKE) ** 2, 1.0)
        # What cameras measure errs alike over a stand.
        variance = _SEEN_ABOVE**2 * (spread / independent + (noise / total) ** 2)
        said = np.where(before >= TALL, before, np.nan).ravel()
        trust = 1 / variance, np.nan_to_num(1 / (_SAID * said) ** 2)
        height = (trust[0] * _SEEN_ABOVE * mean + trust[1] * np.nan_to_num(said)) / sum(trust)
    # The weighted mean of what stands is at least TALL; from above it is too.
    found = np.where(count >= _LEAST_SHARE * ratio, np.maximum(height, TALL), np.nan)
    return found.reshape(fuel.shape).astype(np.float32)
