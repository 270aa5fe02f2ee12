"""What an update of the map means for a fire: on the map as it was and as it is, cell by cell and in hectares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ltm_core.errors import RasterError
from ltm_core.fire.pyretechnics import FireRun
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.types import BoolArray, Float32Array

USUAL_HOURS = (1.0, 3.0, 6.0)


@dataclass(frozen=True)
class Area:
    """Hectares that have burned some hours after ignition; `ensemble`: least, middle and most of the draws but the
    outermost tenths, None without one."""

    hours: float
    before: float
    after: float
    ensemble: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class FireEffect:
    """`changed`: (H, W) cells of which fuel or canopy differ. `probability`: (H, W) share of the drawn landscapes on
    which a cell burns; None: none was drawn.
    """

    before: FireRun
    after: FireRun
    changed: BoolArray
    cell: float
    hours: float
    probability: Float32Array | None = None
    members: tuple[tuple[float, ...], ...] = ()
    """Of each draw, the hectares at the hours of `hours_shown`."""

    def difference(self) -> Float32Array:
        """(H, W) hours by which the fire comes later on the map as it is; NaN where it does not come on both."""
        return self.after.arrival - self.before.arrival

    def flame_difference(self) -> Float32Array:
        """(H, W) metres by which flames are longer on the map as it is; NaN where the fire does not come on both."""
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
        """Hours after which a fire, on the map as it was or as it is, comes to a changed cell; None: to none. What does
        not burn any more was reached before.
        """
        there = np.concatenate([run.arrival[self.changed & run.burned] for run in (self.before, self.after)])
        return float(there.min()) if there.size else None

    def _hectares(self, run: FireRun, hours: float) -> float:
        return hectares(run, hours, self.cell)


def hectares(run: FireRun, hours: float, cell: float) -> float:
    return float(run.burned_by(hours).sum() * cell**2 / 1e4)


def changed_fuel(before: Landscape, after: Landscape) -> BoolArray:
    """(H, W): cells of which the fuel model or a band of canopy differs. Raises RasterError for other grids."""
    if before.geometry.shape != after.geometry.shape:
        raise RasterError(f"landscapes of {before.geometry.shape} and {after.geometry.shape} cells cannot be compared")
    return np.asarray((before.bands[3:] != after.bands[3:]).any(axis=0))


def burn_probability(runs: Sequence[FireRun]) -> Float32Array:
    """(H, W): share of the fires that come to a cell."""
    return np.asarray(np.mean([run.burned for run in runs], axis=0), np.float32)
