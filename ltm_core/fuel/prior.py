"""The prior fuel map (such as LANDFIRE) on the fuel grid, from which evidence starts."""

from __future__ import annotations

from dataclasses import dataclass

from ltm_core.errors import RasterError
from ltm_core.fuel.codes import FuelSystem
from ltm_core.fuel.life_form import NODATA
from ltm_core.grid import GridGeometry
from ltm_core.types import Int16Array

CANOPY_BANDS = ("cover", "height", "base_height", "bulk_density")


@dataclass(frozen=True, eq=False)
class FuelPrior:
    """An existing fuel map on the fuel grid.

    `codes`: (H, W) int16 fuel codes of `system`, NODATA where none is known. `canopy`: (4, H, W) int16 in LANDFIRE's
    units: cover %, height m x 10, base height m x 10, bulk density kg/m3 x 100; NODATA where unknown; None: not given.
    `fbfm13`: (H, W) int16, the FBFM13 map that came beside FBFM40 codes, NODATA where exports do not keep
    it. `contradicting`: cells in which it came with another fuel type than theirs. Raises RasterError where shapes
    disagree.
    """

    codes: Int16Array
    geometry: GridGeometry
    system: FuelSystem = FuelSystem.FBFM40
    canopy: Int16Array | None = None
    fbfm13: Int16Array | None = None
    contradicting: int = 0

    def __post_init__(self) -> None:
        shape = self.geometry.shape
        bands = {
            "codes": (self.codes, shape),
            "canopy": (self.canopy, (len(CANOPY_BANDS), *shape)),
            "FBFM13 codes": (self.fbfm13, shape),
        }
        for name, (band, wanted) in bands.items():
            if band is not None and band.shape != wanted:
                raise RasterError(f"{name} of shape {band.shape} do not fit a fuel grid of {shape}")
        if not (self.codes != NODATA).any():
            raise RasterError("the prior fuel map holds no code at all on the fuel grid: does it lie elsewhere?")


def system_of(prior: FuelPrior | None) -> FuelSystem:
    """Of a map's codes: its prior's, FBFM40 without one."""
    return FuelSystem.FBFM40 if prior is None else prior.system
