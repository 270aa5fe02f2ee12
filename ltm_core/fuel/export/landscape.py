"""The eight bands of a fire model's landscape: elevation, slope, aspect, fuel model and four of canopy, on one grid."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Float64Array, Int16Array
from ltm_core.fuel.codes import FuelClimate, FuelSystem, fuel_models
from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.life_form import NODATA, LifeForm, forms_of
from ltm_core.fuel.prior import FuelPrior, system_of
from ltm_core.geometry.grid import GridGeometry

LANDSCAPE_BANDS: Final = ("elevation", "slope", "aspect", "fuel", "cover", "height", "base_height", "bulk_density")
LANDSCAPE_UNITS: Final = ("m", "degrees", "degrees", "code", "percent", "m x 10", "m x 10", "kg/m3 x 100")
FLAT: Final = -1
"""LANDFIRE's aspect of level ground."""
_ENOUGH_CELLS = 20
"""Minimum number of the prior's tree cells from which the canopy of a code is learned."""


@dataclass(frozen=True, eq=False)
class Landscape:
    """`bands`: (8, H, W) int16 in the order of `LANDSCAPE_BANDS` and in LANDFIRE's units, NODATA where unknown: m;
    degrees; degrees clockwise from grid north, downhill, -1 flat; fuel code; cover %; heights m x 10; kg/m3 x 100.
    `geometry` names its CRS. `dropped`: cells with a code, of which no height is known: they have no data in any
    band. Raises RasterError where the CRS is missing, or shapes disagree."""

    bands: Int16Array
    geometry: GridGeometry
    system: FuelSystem = FuelSystem.FBFM40
    dropped: int = 0

    def terrain_note(self) -> str:
        """Return a note about heights that the site's terrain lacks; empty if it has all."""
        return f"{self.dropped} cells with a code have no elevation and are nodata" if self.dropped else ""

    def __post_init__(self) -> None:
        if self.bands.shape != (len(LANDSCAPE_BANDS), *self.geometry.shape) or self.bands.dtype != np.int16:
            raise RasterError(
                f"a landscape is {len(LANDSCAPE_BANDS)} int16 bands of {self.geometry.shape} cells, "
                f"got {self.bands.shape} {self.bands.dtype}"
            )
        if self.geometry.crs is None:
            raise RasterError("a landscape needs a CRS, but this grid has none")

    def band(self, name: str) -> Int16Array:
        return np.asarray(self.bands[LANDSCAPE_BANDS.index(name)])


def slope_and_aspect(elevation: NDArray[np.floating], cell: float) -> tuple[Float64Array, Float64Array]:
    """Return the degrees (H - 2, W - 2) of an elevation raster (H, W) with square cells, without its border. Source:
    Horn (1981), Hill shading and the reflectance map, as gdaldem. Aspect is downhill, clockwise from grid north, FLAT
    where the ground is level; both are NaN where the height is unknown. Where a neighbour's is, the slope from the
    cell's other side is extended."""
    heights = np.asarray(elevation, np.float64)
    height, width = (n - 2 for n in heights.shape)
    own = heights[1:-1, 1:-1]

    def beside(down: int, right: int) -> Float64Array:
        there, across = (
            heights[1 + k * down : 1 + k * down + height, 1 + k * right : 1 + k * right + width] for k in (1, -1)
        )
        return np.where(np.isnan(there), np.where(np.isnan(across), own, 2 * own - across), there)

    weights = ((-1, 1), (0, 2), (1, 1))
    east = sum(weight * (beside(k, 1) - beside(k, -1)) for k, weight in weights) / (8 * cell)
    south = sum(weight * (beside(1, k) - beside(-1, k)) for k, weight in weights) / (8 * cell)
    east = np.where(np.isnan(own), np.nan, east)
    slope = np.degrees(np.arctan(np.hypot(east, south)))
    return slope, np.where((east == 0) & (south == 0), float(FLAT), np.degrees(np.arctan2(-east, south)) % 360)


def terrain_bands(padded: NDArray[np.floating], cell: float) -> Int16Array:
    """Return elevation, slope and aspect (3, H, W) of heights (H + 2, W + 2) with a border of one cell; NODATA where
    the height is unknown."""
    slope, aspect = slope_and_aspect(padded, cell)
    # 360 is 0, and a slope that rounds to 0 may keep its direction.
    turned = np.where(aspect == FLAT, FLAT, np.round(aspect) % 360)
    bands = np.stack([np.round(padded[1:-1, 1:-1]), np.round(slope), turned])
    return np.where(np.isnan(bands), NODATA, bands).astype(np.int16)


def canopy_bands(layers: FuelLayers, prior: FuelPrior | None, climate: FuelClimate) -> Int16Array:
    """Return cover, height, base height and bulk density (4, H, W) for the layers' codes. The prior's stay where its
    code stays. Cells that have become trees get the median of the prior's own cells of their code or, where there are
    few, the climate's canopy; cells that have lost them get none. Bands that the prior lacks are the climate's under
    trees, none elsewhere."""
    c = climate.canopy
    new = np.array([c.cover, 10 * c.height, 10 * c.base_height, 100 * c.bulk_density])
    shape = layers.code.shape
    given = prior.canopy if prior is not None else None
    known = layers.code != NODATA
    has_trees = forms_of(layers.code)[..., LifeForm.TREE - 1]
    plain = np.where(known, np.where(has_trees, new[:, None, None], 0.0), NODATA)
    if given is None:
        return np.round(plain).astype(np.int16)
    bare = (given[0] == 0) & ~layers.changed
    bands = np.where(given != NODATA, given, np.where(bare & known, 0.0, plain)).reshape(4, *shape)
    bands[:, layers.changed & ~has_trees] = 0
    for code in np.unique(layers.code[layers.changed & has_trees]):
        like = (layers.prior == code) & (given[0] > 0)
        into = layers.changed & has_trees & (layers.code == code)
        for k in range(len(bands)):
            values = given[k][like & (given[k] != NODATA)]
            bands[k][into] = np.median(values) if len(values) >= _ENOUGH_CELLS else new[k]
    return np.round(bands).astype(np.int16)


def surface_codes(layers: FuelLayers, prior: FuelPrior | None, climate: FuelClimate, system: FuelSystem) -> Int16Array:
    """Return the layers' codes in a system, with the fuel type that they have in their own. Cells that have changed, or
    never had a prior, take what the climate has for such cells in that system. The others take the FBFM13 map that came
    with the prior where one did (`PriorConfig.own_fbfm13`), else the climate's crosswalk. An analyst's own models, 14
    to 89, stay, and so do codes of no system that the site keeps (`PriorConfig.unknown_codes`)."""
    own = system_of(prior)
    if system is own:
        return layers.code
    cover = None if prior is None or prior.canopy is None else prior.canopy[0]
    crossed, given = climate.crossed(layers.code, system, cover), None if prior is None else prior.fbfm13
    if given is not None:
        crossed = np.where(given != NODATA, given, crossed)
    unknown = ~np.isin(layers.code, list(fuel_models().codes(own)))
    crossed = np.where((crossed == NODATA) & unknown, layers.code, crossed)
    new = layers.changed | (layers.prior == NODATA)
    changed = climate.changed_codes(layers.code, own, system)
    fallback = climate.crossed(layers.code, system)
    return np.where(new, np.where(changed != NODATA, changed, fallback), crossed).astype(np.int16)
