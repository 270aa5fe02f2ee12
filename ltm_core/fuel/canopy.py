"""Estimate the canopy of fuel cells: stand heights, crown base and bulk density, and what remains after change.

Base and bulk density of conifer crowns, from the cover and height of a stand, by published allometry.

Cruz, Alexander and Wakimoto (2003, Int. J. Wildland Fire 12(1), 39-50) give both for four forest types of western North
America, of the basal area B (m2/ha), the number of stems N (1/ha) and the height H (m):

    ln density = a + b ln B + c ln N,    base = d + e H + f B

B and N follow from cover and height: crowns stand at random, so that N pi r^2 = -ln(1 - cover), their radius r is
0.15 H, and stems are H / 70 thick. These two shares are assumed, and so are the standard errors; what is used is only
how both change from one stand to another, in which the shares all but cancel. Of broadleaved stands it says nothing.

Canopy of fuel cells by what cameras have seen: its cover and height, and what follows for crown base and density.

Where the surface was confirmed to have changed, from that over bare earth (only where a raster of tree tops says what
stood there before), and from labels (`label_cover`); where trees are new or the prior has no canopy, cover from
labels, and height from depth against bare earth (`stand_heights`). Elsewhere, and where nobody has looked, the canopy
stays what the prior or the region says.

Heights of stands from depth against bare earth, for sites without a raster of tree tops.

There the terrain map takes what the first agreeing views measured in a cell for its canopy. A cell that a sight meets
half at a crown and half through a gap has a mean of both, which is the height of neither. So of a fuel cell the height
follows from the mean of what stands with each cell's own height as its weight (as Lorey's mean height of a stand has
it): of cells p h high, p the share that crowns had in them, that is the mean of h where p is 0 or 1, and little less
where it is not. It is above that of the canopy from above, since of crowns beside each other the higher are seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Float64Array, IndexArray, Int16Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.surface.confirmed_terrain import ConfirmedTerrain
from ltm_core.surface.fuel_change import LEAST_SHARE
from ltm_core.surface.surface_map import SurfaceMap

BROADLEAVED: Final = (9, 182, 186, 189)
"""Codes of broadleaf litter, of either system (Scott and Burgan 2005: TL2, TL6, TL9)."""
DENSITY_ERROR, BASE_ERROR = 0.4, 0.5
"""Standard error as a share of the value; assumed: Cruz' plots scatter by about as much around his curves."""
MOST_DENSITY: Final = 0.45
"""Bulk density, kg/m3, to which a stand is followed at most, unless it was said to be denser; assumed. Low stands lie
outside of those that the lines were drawn of: one of 15 m that is now 3 m high would come to 8 kg/m3."""
_CROWN_RADIUS: Final = 0.15
_SLENDERNESS: Final = 70.0
_MOST_COVER: Final = 0.95
_LEAST_BASE: Final = 0.05
"""Of the height: below the stands of which the line was drawn it would be less than nothing."""


class ForestType(StrEnum):
    DOUGLAS_FIR = "douglas_fir"
    PONDEROSA_PINE = "ponderosa_pine"
    LODGEPOLE_PINE = "lodgepole_pine"
    MIXED_CONIFER = "mixed_conifer"


_DENSITY: Final = {
    ForestType.DOUGLAS_FIR: (-7.380, 0.479, 0.625),
    ForestType.PONDEROSA_PINE: (-6.649, 0.435, 0.579),
    ForestType.LODGEPOLE_PINE: (-7.852, 0.349, 0.711),
    ForestType.MIXED_CONIFER: (-8.445, 0.319, 0.859),
}
_BASE: Final = {
    ForestType.DOUGLAS_FIR: (-1.771, 0.554, 0.045),
    ForestType.PONDEROSA_PINE: (0.134, 0.393, 0.049),
    ForestType.LODGEPOLE_PINE: (-1.475, 0.613, 0.043),
    ForestType.MIXED_CONIFER: (-1.463, 0.578, 0.026),
}


@dataclass(frozen=True, eq=False)
class CrownFuel:
    """(...) `base`: height of the crowns' base, m; `density`: canopy bulk density, kg/m3; 0 where nothing stands."""

    base: Float64Array
    density: Float64Array


def crown_fuel(cover: Float64Array, height: Float64Array, forest: ForestType) -> CrownFuel:
    """Of stands with `cover` (...) in % and `height` (...) in metres."""
    share, tall = np.clip(cover / 100, 0.0, _MOST_COVER), np.maximum(height, 0.0)
    stands = (share > 0) & (tall > 0)
    tall = np.where(stands, tall, 1.0)
    stems = np.where(stands, -np.log1p(-share), 1.0) / (np.pi * (_CROWN_RADIUS * tall) ** 2) * 1e4
    basal_area = stems * np.pi / 4 * (tall / _SLENDERNESS) ** 2
    a, b, c = _DENSITY[forest]
    d, e, f = _BASE[forest]
    base = np.clip(d + e * tall + f * basal_area, _LEAST_BASE * tall, tall)
    density = np.exp(a + b * np.log(basal_area) + c * np.log(stems))
    return CrownFuel(np.where(stands, base, 0.0), np.where(stands, density, 0.0))


def broadleaved(codes: Int16Array) -> BoolArray:
    """(...) where a code's trees have no crown fuel to speak of."""
    return np.isin(codes, BROADLEAVED)


TALL = 2.0
"""Metres above ground from which on plants are canopy: the height break of airborne surveys of tree cover."""
ALIKE = 5.0
"""Metres within which heights of a stand err and vary together, as the surface map smooths them."""
_MOST_SAMPLES = 30
"""Of the surface, a side of a fuel cell."""
_STANDING = 0.5
"""Standard error of the cover of a thinned cell, by that cover."""
_CELLS = 1000
"""Fuel cells that are worked on at a time."""


@dataclass(frozen=True, eq=False)
class SeenCanopy:
    """(H, W) each, NaN where it was not measured. `cover`: %; `height`: mean of the canopy's top over bare earth,
    metres, 0 where no canopy is left; and the standard errors of both. `thinned`: (H, W), where more of a changed
    surface is lower than higher, so that what still stands may only not have been confirmed as gone yet; None: nowhere.
    """

    cover: Float32Array
    height: Float32Array
    cover_sigma: Float32Array
    height_sigma: Float32Array
    thinned: BoolArray | None = None


def seen_canopy(terrain: ConfirmedTerrain, grid: GridGeometry) -> SeenCanopy | None:
    """Of the cells of a fuel grid (in the map frame) a quarter of which has changed; None where nothing is confirmed,
    or it is not known what stood on the ground before.
    """
    if terrain.surface is None or not terrain.canopy_known:
        return None
    cells = terrain.surface
    row, col = grid.cell_of(*cells.geometry.to_map(cells.rows, cells.cols))
    inside = grid.contains(row, col)
    counts = np.bincount(row[inside] * grid.width + col[inside], minlength=grid.width * grid.height)
    ratio = grid.resolution / cells.geometry.resolution
    chosen = np.flatnonzero(counts >= LEAST_SHARE * ratio**2)
    lower = np.zeros(len(cells), np.bool_)
    if terrain.given is not None:
        lower = cells.surface < terrain.given.elevation_at(*cells.geometry.to_map(cells.rows, cells.cols))
    lost = np.bincount(row[inside & lower] * grid.width + col[inside & lower], minlength=grid.width * grid.height)
    found = np.full((4, grid.height * grid.width), np.nan, np.float32)
    side = int(np.clip(round(ratio), 1, _MOST_SAMPLES))
    for start in range(0, len(chosen), _CELLS):
        part = chosen[start : start + _CELLS]
        found[:, part] = _measured(terrain.top, terrain.ground, grid, part, side)
    thinned = (counts >= LEAST_SHARE * ratio**2) & (2 * lost > counts)
    found[2] = np.where(thinned, np.hypot(found[2], _STANDING * found[0]), found[2])
    cover, height, cover_sigma, height_sigma = found.reshape(4, *grid.shape)
    return SeenCanopy(cover, height, cover_sigma, height_sigma, thinned.reshape(grid.shape))


def measured_canopy(
    trees: BoolArray,
    new: BoolArray,
    changed: SeenCanopy | None,
    labels: tuple[Float64Array, Float64Array] | None,
    heights: tuple[Float32Array, Float32Array] | None,
) -> SeenCanopy:
    """What was measured of the cells with `trees` (H, W), of all sources.

    Args:
        new: (H, W) trees that were none, or of which the prior has no canopy: there labels and heights alone are taken.
        changed: from the confirmed surface.
        labels: cover by labels and its standard error, % (`EvidenceMap.label_cover`).
        heights: of stands and their standard errors, metres (`stand_heights`).
    """
    unknown = np.full(trees.shape, np.nan, np.float32)
    found = SeenCanopy(unknown, unknown, unknown, unknown) if changed is None else changed
    moved, use = np.isfinite(found.cover), trees & new
    cover, cover_sigma = (a.astype(np.float64) for a in (found.cover, found.cover_sigma))
    if labels is not None:
        value, sigma = labels
        with np.errstate(invalid="ignore"):
            weights = 1 / cover_sigma**2, 1 / sigma**2
            # Where no canopy is left there is none to be found by labels: shrubs are woody too.
            doubt = np.zeros(trees.shape, np.bool_) if found.thinned is None else found.thinned
            both = moved & doubt & trees & np.isfinite(value) & (found.cover > 0)
            mean = (weights[0] * cover + weights[1] * value) / (weights[0] + weights[1])
            cover = np.where(both, mean, np.where(use & ~moved, value, cover))
            cover_sigma = np.where(
                both, 1 / np.sqrt(weights[0] + weights[1]), np.where(use & ~moved, sigma, cover_sigma)
            )
    tops, top_sigma = found.height, found.height_sigma
    if heights is not None:
        alone = use & ~moved
        tops, top_sigma = (np.where(alone, h, t) for h, t in zip(heights, (tops, top_sigma), strict=True))
    return SeenCanopy(
        cover.astype(np.float32),
        tops.astype(np.float32),
        cover_sigma.astype(np.float32),
        top_sigma.astype(np.float32),
        found.thinned,
    )


def with_seen_canopy(
    bands: Int16Array, seen: SeenCanopy, codes: Int16Array, forest: ForestType = ForestType.MIXED_CONIFER
) -> Int16Array:
    """Canopy bands (4, H, W) of cells with trees as they are seen now: cover and height as measured, each where it is;
    crown base and bulk density change from what they were as those of such stands do (`stand_allometry`). Those of
    broadleaved `codes` (H, W) stay. Cells without trees stay.
    """
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
    """Cover, height and their standard errors (4, N) of cells by their flat places, from side x side points each."""
    rows, cols = np.divmod(cells, grid.width)
    offsets = (np.arange(side) + 0.5) / side - 0.5
    x, y = grid.to_map(rows[:, None, None] + offsets[:, None], cols[:, None, None] + offsets)
    x, y = (points.reshape(len(cells), -1) for points in np.broadcast_arrays(x, y))
    above = top.elevation_at(x, y) - ground.elevation_at(x, y)
    known = np.isfinite(above)
    canopy = known & (above >= TALL)
    stands, points = canopy.sum(axis=1), np.maximum(known.sum(axis=1), 1)
    share = stands / points
    height = np.where(canopy, above, 0.0).sum(axis=1) / np.maximum(stands, 1)
    spread = np.sqrt((np.where(canopy, above - height[:, None], 0.0) ** 2).sum(axis=1) / np.maximum(stands, 1))
    independent = (grid.resolution / ALIKE) ** 2
    # No sample is without error.
    some = np.clip(share, 1 / independent, 1 - 1 / independent)
    errors = (
        100 * np.sqrt(some * (1 - some) / independent),
        spread / np.sqrt(np.maximum(independent * share, 1)),
    )
    found = np.stack([100 * share, height, *errors])
    return np.where(known.any(axis=1), found, np.nan).astype(np.float32)


_STRIP = 256
"""Rows of the terrain that are worked on at a time."""
_LEAST_SHARE = 0.1
"""Of a fuel cell that must have been seen as standing."""
_SEEN_ABOVE = 0.8
"""Mean height of a canopy from above by that of what is seen of it from the side, weighted by height; this and what
follows was chosen on rendered sites (docs/exports.md)."""
_SAID = 1 / 3
"""Standard error of a height that a map said before, by that height."""


def stand_heights(surface: SurfaceMap, fuel: GridGeometry, before: Float64Array) -> tuple[Float32Array, Float32Array]:
    """Of the cells of a fuel grid (in the map frame): mean height of what stands 2 m and more over bare earth where
    independent views have measured it, and its standard error, metres; NaN where hardly anything was seen to stand.
    `before` (H, W): what a map said, metres, which meets what was measured by their standard errors; NaN, or too low to
    stand: nothing.
    """
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
        independent = np.maximum(count / ratio * (fuel.resolution / ALIKE) ** 2, 1.0)
        # What cameras measure errs alike over a stand.
        variance = _SEEN_ABOVE**2 * (spread / independent + (noise / total) ** 2)
        said = np.where(before >= TALL, before, np.nan).ravel()
        trust = 1 / variance, np.nan_to_num(1 / (_SAID * said) ** 2)
        height = (trust[0] * _SEEN_ABOVE * mean + trust[1] * np.nan_to_num(said)) / sum(trust)
        sigmas = 1 / np.sqrt(sum(trust))
    # The weighted mean of what stands is at least TALL; from above it is too.
    height = np.maximum(height, TALL)
    known = count >= _LEAST_SHARE * ratio
    return (
        np.where(known, height, np.nan).reshape(fuel.shape).astype(np.float32),
        np.where(known, sigmas, np.nan).reshape(fuel.shape).astype(np.float32),
    )
