"""Transfer a site's fuel map and terrain to the grid and CRS of an exported file."""

from dataclasses import fields, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.fuel.canopy import with_seen_canopy
from ltm_core.fuel.class_map import UNSEEN
from ltm_core.fuel.codes import FuelClimate, FuelSystem
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.export.landscape import Landscape, canopy_bands, surface_codes, terrain_bands
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import FuelPrior
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem

_MOST_SAMPLES = 8
"""Maximum number of DEM samples per side of a fuel cell for its mean height."""


class GridTransfer:
    """Resample layers from one grid to another by nearest cell, as codes require; both grids have a CRS."""

    def __init__(self, source: GridGeometry, target: GridGeometry) -> None:
        self.source, self.target = source, target
        self._to_source = Transformer.from_crs(target.crs, source.crs, always_xy=True)
        x, y = target.to_map(*np.indices(target.shape))
        rows, cols = source.cell_of(*self._to_source.transform(x, y))
        self._inside = source.contains(rows, cols)
        self._rows, self._cols = np.where(self._inside, rows, 0), np.where(self._inside, cols, 0)

    def layer(self, layer: NDArray[Any], outside: float) -> NDArray[Any]:
        """Return (..., H, W) on the target grid; `outside` beyond the source."""
        taken = layer[..., self._rows, self._cols]
        return np.where(self._inside, taken, np.array(outside, layer.dtype))

    def layers(self, layers: FuelLayers) -> FuelLayers:
        outside = {"prior": NODATA, "code": NODATA, "life_form": UNSEEN, "p_max": np.nan, "entropy": 1.0}
        moved = {f.name: self.layer(getattr(layers, f.name), outside.get(f.name, 0)) for f in fields(layers)}
        return FuelLayers(**moved)

    def heights(self, dem: Dem, frame: SiteFrame) -> Float64Array:
        """Return mean heights (H + 2, W + 2) of the target's cells and of a border of one cell, from a DEM in the map
        frame: over the known part of the cell; NaN where nothing is known."""
        g, cell = self.target, self.target.resolution
        around = GridGeometry(g.x_min - cell, g.y_max + cell, cell, g.width + 2, g.height + 2, g.crs)
        count = int(np.clip(round(g.resolution / dem.geometry.resolution), 1, _MOST_SAMPLES))
        offsets = (np.arange(count) + 0.5) / count - 0.5
        to_site = Transformer.from_crs(g.crs, frame.crs, always_xy=True)
        total, known = np.zeros(around.shape), np.zeros(around.shape)
        rows, cols = np.indices(around.shape)
        for down, right in product(offsets, offsets):
            x, y = to_site.transform(*around.to_map(rows + down, cols + right))
            found = _height(dem, np.asarray(x) - frame.x_origin, np.asarray(y) - frame.y_origin)
            total += np.nan_to_num(found)
            known += np.isfinite(found)
        return np.where(known > 0, total / np.maximum(known, 1), np.nan)


def _height(dem: Dem, x: Float64Array, y: Float64Array) -> Float64Array:
    """Of the ground, out to the edges of the DEM's outer cells: interpolated between the centres of cells, and half a
    cell beyond the last one is still that cell's."""
    g = dem.geometry
    half, inside = 0.5001 * g.resolution, (x >= g.x_min) & (x <= g.x_max) & (y >= g.y_min) & (y <= g.y_max)
    x_in, y_in = np.clip(x, g.x_min + half, g.x_max - half), np.clip(y, g.y_min + half, g.y_max - half)
    return np.where(inside, dem.elevation_at(x_in, y_in), np.nan).astype(np.float64)


def make_landscape(
    layers: FuelLayers,
    prior: FuelPrior | None,
    dem: Dem,
    frame: SiteFrame,
    source: GridGeometry,
    climate: FuelClimate,
    system: FuelSystem,
    target: GridGeometry | None = None,
    seen: Float32Array | None = None,
) -> Landscape:
    """Return the landscape of a fuel map on its own grid or on `target`. A cell has all of elevation, slope, aspect and
    code, or none.

    Args:
        source: the grid of layers and prior, in the site's CRS.
        dem: in the map frame of `frame`.
        seen: the canopy that was measured (`seen_canopy`), on the grid of the layers; None: nowhere."""
    transfer = GridTransfer(source, source if target is None else target)
    canopy = canopy_bands(layers, prior, climate)
    if seen is not None:
        canopy = with_seen_canopy(canopy, seen, layers.code, climate.forest)
    codes = transfer.layer(surface_codes(layers, prior, climate, system), NODATA)
    terrain = terrain_bands(transfer.heights(dem, frame), source.resolution)
    bands = np.concatenate([terrain, codes[None], transfer.layer(canopy, NODATA)]).astype(np.int16)
    dropped = (bands[0] == NODATA) & (codes != NODATA)
    bands[:, dropped] = NODATA
    return Landscape(bands, transfer.target, system, int(dropped.sum()))


def with_fuel(landscape: Landscape, layers: FuelLayers, prior: FuelPrior | None, climate: FuelClimate) -> Landscape:
    """Return a landscape of the fuel grid with the fuel and canopy of other layers on the same ground."""
    bands = landscape.bands.copy()
    bands[3] = surface_codes(layers, prior, climate, landscape.system)
    bands[4:] = canopy_bands(layers, prior, climate)
    bands[:, bands[0] == NODATA] = NODATA
    return replace(landscape, bands=bands)
