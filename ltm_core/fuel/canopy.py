"""Update the canopy of cells whose surface has changed: cover and height as views have confirmed them over bare earth,
crown base and bulk density by published allometry. Other cells keep the canopy of the prior or the climate.

Cruz, Alexander and Wakimoto (2003, Int. J. Wildland Fire 12(1), 39-50) give base and density for four forest types of
western North America, of the basal area B (m2/ha), the number of stems N (1/ha) and the height H (m):

    ln density = a + b ln B + c ln N,    base = d + e H + f B

B and N follow from cover and height: crowns stand at random, so that N pi r^2 = -ln(1 - cover), their radius r is
0.15 H, and stems are H / 70 thick. These shares are assumed; only changes of a stand are used, in which they all but
cancel. Of broadleaved stands it says nothing."""

from typing import Final

import numpy as np

from ltm_core.base.types import Float32Array, Float64Array, IndexArray, Int16Array
from ltm_core.fuel.codes import ForestType
from ltm_core.fuel.surface_change import LEAST_SHARE
from ltm_core.geometry.grid import GridGeometry
from ltm_core.surface.surface_versions_io import ConfirmedTerrain

TALL = 2.0
"""Height in metres above which plants are canopy, the height break of airborne surveys of tree cover."""
_MOST_SAMPLES = 30
"""Maximum number of surface samples per side of a fuel cell."""
_CELLS = 1000
"""Number of fuel cells processed at a time."""
BROADLEAVED: Final = (9, 182, 186, 189)
"""Codes of broadleaf litter in both systems (Scott and Burgan 2005: TL2, TL6, TL9)."""
MOST_DENSITY: Final = 0.45
"""Maximum bulk density in kg/m3 of the allometry, unless the map stated more; assumed. Low stands are outside the range
of the data: a stand of 15 m that is now 3 m high would get 8 kg/m3."""
_CROWN_RADIUS: Final = 0.15
_SLENDERNESS: Final = 70.0
_MOST_COVER: Final = 0.95
_LEAST_BASE: Final = 0.05
"""Minimum crown base as a share of the height; below the range of the data, the line would be negative."""
_ALLOMETRY: Final = {
    ForestType.DOUGLAS_FIR: ((-7.380, 0.479, 0.625), (-1.771, 0.554, 0.045)),
    ForestType.PONDEROSA_PINE: ((-6.649, 0.435, 0.579), (0.134, 0.393, 0.049)),
    ForestType.LODGEPOLE_PINE: ((-7.852, 0.349, 0.711), (-1.475, 0.613, 0.043)),
    ForestType.MIXED_CONIFER: ((-8.445, 0.319, 0.859), (-1.463, 0.578, 0.026)),
}
"""(a, b, c) and (d, e, f)."""


def seen_canopy(terrain: ConfirmedTerrain, grid: GridGeometry) -> Float32Array | None:
    """Return the canopy (2, H, W) of the cells of a fuel grid (in the map frame) that have changed by at least a
    quarter: cover in %, and mean of the canopy's top over bare earth in metres, 0 where no canopy is left; NaN where it
    was not measured. None if nothing is confirmed, or if the earlier canopy is unknown."""
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
        found[:, part] = _measured(terrain, grid, part, side)
    return found.reshape(2, *grid.shape)


def _measured(terrain: ConfirmedTerrain, grid: GridGeometry, cells: IndexArray, side: int) -> Float32Array:
    """Return the cover and height (2, N) of cells by their flat places, from side x side points each."""
    rows, cols = np.divmod(cells, grid.width)
    offsets = (np.arange(side) + 0.5) / side - 0.5
    x, y = grid.to_map(rows[:, None, None] + offsets[:, None], cols[:, None, None] + offsets)
    x, y = (points.reshape(len(cells), -1) for points in np.broadcast_arrays(x, y))
    above = terrain.top.elevation_at(x, y) - terrain.ground.elevation_at(x, y)
    known = np.isfinite(above)
    canopy = known & (above >= TALL)
    stands, points = canopy.sum(axis=1), np.maximum(known.sum(axis=1), 1)
    height = np.where(canopy, above, 0.0).sum(axis=1) / np.maximum(stands, 1)
    found = np.stack([100 * stands / points, height])
    return np.where(known.any(axis=1), found, np.nan).astype(np.float32)


def with_seen_canopy(
    bands: Int16Array, seen: Float32Array, codes: Int16Array, forest: ForestType = ForestType.MIXED_CONIFER
) -> Int16Array:
    """Return canopy bands (4, H, W) of cells with trees, updated by observations (`seen_canopy`): cover and height as
    measured; crown base and bulk density change in proportion to the allometry of such stands. Base and density of
    broadleaved `codes` (H, W), and cells without trees, do not change."""
    cover, height, base, density = (band.astype(np.float64) for band in bands)
    share, tops = seen[0].astype(np.float64), 10.0 * seen[1].astype(np.float64)
    now = np.isfinite(share) & np.isfinite(tops) & (cover > 0) & (height > 0)
    was, is_ = (crown_fuel(c, h / 10, forest) for c, h in ((cover, height), (share, tops)))
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = np.stack([share, tops, base * is_[0] / was[0], density * is_[1] / was[1]])
    left = (share > 0) & (tops > 0)
    moved[2:] = np.where(np.isin(codes, BROADLEAVED), np.where(left, bands[2:], 0), moved[2:])
    moved[2] = np.minimum(moved[2], tops)
    moved[3] = np.minimum(moved[3], np.maximum(density, 100 * MOST_DENSITY))
    return np.where(now & np.isfinite(moved).all(axis=0), np.round(moved), bands).astype(np.int16)


def crown_fuel(cover: Float64Array, height: Float64Array, forest: ForestType) -> tuple[Float64Array, Float64Array]:
    """Return the crown base in metres and the canopy bulk density in kg/m3 (...) of stands with `cover` (...) in % and
    `height` (...) in metres; 0 without trees."""
    share, tall = np.clip(cover / 100, 0.0, _MOST_COVER), np.maximum(height, 0.0)
    stands = (share > 0) & (tall > 0)
    tall = np.where(stands, tall, 1.0)
    stems = np.where(stands, -np.log1p(-share), 1.0) / (np.pi * (_CROWN_RADIUS * tall) ** 2) * 1e4
    basal_area = stems * np.pi / 4 * (tall / _SLENDERNESS) ** 2
    (a, b, c), (d, e, f) = _ALLOMETRY[forest]
    base = np.clip(d + e * tall + f * basal_area, _LEAST_BASE * tall, tall)
    density = np.exp(a + b * np.log(basal_area) + c * np.log(stems))
    return np.where(stands, base, 0.0), np.where(stands, density, 0.0)
