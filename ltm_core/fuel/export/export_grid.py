"""Transfers a site's fuel map and terrain to the grid and CRS of an exported file."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from ltm_core.dem import Dem
from ltm_core.errors import ConfigError
from ltm_core.fuel.codes import FuelRegion, FuelSystem
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.export.landscape import Landscape, canopy_bands, surface_codes, terrain_bands
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.majority import UNSEEN
from ltm_core.fuel.prior import FuelPrior
from ltm_core.geodesy import SiteFrame
from ltm_core.grid import GridGeometry
from ltm_core.types import Float64Array

_MOST_SAMPLES = 8
"""Of the DEM, a side of a fuel cell, for its mean height."""


def snapped_grid(geometry: GridGeometry, crs: str, phase: float = 15.0) -> GridGeometry:
    """The grid of the same resolution over `geometry` in another CRS, edges at phase mod resolution, as LANDFIRE's in
    EPSG:5070. Raises ConfigError where the CRS is unknown or not projected in metres.
    """
    from rasterio.warp import transform_bounds

    SiteFrame(crs)
    if geometry.crs is None:
        raise ConfigError("a fuel grid in a bare map frame cannot be put into another CRS")
    return GridGeometry.snapped(transform_bounds(geometry.crs, crs, *geometry.bounds), geometry.resolution, phase, crs)


class GridTransfer:
    """Takes layers from one grid to another by nearest cell, which is what codes allow; both grids name their CRS."""

    def __init__(self, source: GridGeometry, target: GridGeometry) -> None:
        self.source, self.target = source, target
        self._to_source = Transformer.from_crs(target.crs, source.crs, always_xy=True)
        x, y = target.to_map(*np.indices(target.shape))
        rows, cols = source.cell_of(*self._to_source.transform(x, y))
        self._inside = source.contains(rows, cols)
        self._rows, self._cols = np.where(self._inside, rows, 0), np.where(self._inside, cols, 0)

    def layer(self, layer: NDArray[Any], outside: float) -> NDArray[Any]:
        """(..., H, W) on the target grid; `outside` where the source does not reach."""
        taken = layer[..., self._rows, self._cols]
        return np.where(self._inside, taken, np.array(outside, layer.dtype))

    def layers(self, layers: FuelLayers) -> FuelLayers:
        outside = {"prior": NODATA, "code": NODATA, "life_form": UNSEEN, "p_max": np.nan, "entropy": 1.0}
        moved = {f.name: self.layer(getattr(layers, f.name), outside.get(f.name, 0)) for f in fields(layers)}
        return FuelLayers(**moved)

    def prior(self, prior: FuelPrior) -> FuelPrior:
        canopy = None if prior.canopy is None else self.layer(prior.canopy, NODATA)
        beside = None if prior.fbfm13 is None else self.layer(prior.fbfm13, NODATA)
        codes = self.layer(prior.codes, NODATA)
        return replace(prior, codes=codes, geometry=self.target, canopy=canopy, fbfm13=beside)

    def heights(self, dem: Dem, frame: SiteFrame) -> Float64Array:
        """Mean heights (H + 2, W + 2) of the target's cells and of a border of one cell about it, from a DEM in the map
        frame; NaN where it is not known.
        """
        g = self.target
        around = GridGeometry(
            g.x_min - g.resolution, g.y_max + g.resolution, g.resolution, g.width + 2, g.height + 2, g.crs
        )
        count = int(np.clip(round(g.resolution / dem.geometry.resolution), 1, _MOST_SAMPLES))
        offsets = (np.arange(count) + 0.5) / count - 0.5
        to_site = Transformer.from_crs(g.crs, frame.crs, always_xy=True)
        total = np.zeros(around.shape)
        rows, cols = np.indices(around.shape)
        for down in offsets:
            for right in offsets:
                x, y = to_site.transform(*around.to_map(rows + down, cols + right))
                total += dem.elevation_at(x - frame.x_origin, y - frame.y_origin)
        return total / count**2


def make_landscape(
    layers: FuelLayers,
    prior: FuelPrior | None,
    dem: Dem,
    frame: SiteFrame,
    source: GridGeometry,
    region: FuelRegion,
    system: FuelSystem,
    target: GridGeometry | None = None,
) -> Landscape:
    """The landscape of a fuel map on its own grid or on `target`.

    Args:
        source: the grid of layers and prior, in the site's CRS.
        dem: in the map frame of `frame`.
    """
    transfer = GridTransfer(source, source if target is None else target)
    canopy = transfer.layer(canopy_bands(layers, prior, region), NODATA)
    codes = transfer.layer(surface_codes(layers, prior, region, system), NODATA)
    terrain = terrain_bands(transfer.heights(dem, frame), source.resolution)
    return Landscape(np.concatenate([terrain, codes[None], canopy]).astype(np.int16), transfer.target, system)
