"""How likely a mark is for each place of a fan: the probability density of the marked direction, given the place.

**Where something on the ground is marked** at its own direction. Where the terrain model hides the place by a little,
its error may be the reason: the place then counts by the chance of that.

**Where smoke is marked** at the lowest part of it that is seen. That is its foot where it is seen. Behind a crest it is
where the plume comes up over the crest: in height, the highest of the terrain's slopes from the camera to the place; in
azimuth, the foot's and what the plume has drifted sideways until there, which is the more the farther the marked slope
is above the foot's. `lifts` says how high smoke must stand at a place; a plume is the less likely to be so high.

Slopes of the place and of crests have errors by the terrain model's, the larger the nearer they are: a ridge close to
the camera that the model has a little too low may be what hides the foot (`sight_kernels`).

Along a ray the slope changes from sample to sample; the density is averaged over that change in closed form, or near
and steep ground would fall between the samples.

**A camera that is turned** marks the right slope, and its azimuth says no more than how far it may be turned. In some
cases it is wrong otherwise, and its slope says nothing either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.locating.directions import KNOTS, NEXT_DRIFT, DirectionTable
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sight_fan import Drifts, HeightErrors, RayMark, RayTerrain, SightFan, SmokeDensities
from ltm_core.locating.sight_kernels import ROOT_2PI, add_drifted, add_smeared, ground_along, smoke_along
from ltm_core.raster.dem import Dem

LEVEL_SHARE = 0.1
"""Of a raster's cell size: the least sigma that its heights have between its nodes."""
APART_CELLS = 4.0
"""Cells from which errors of a raster's heights count as independent."""
OTHERWISE = 0.2
"""Share of wrong cameras whose slope is wrong too."""
OTHER_SLOPE = 1 / (math.radians(2.0) * ROOT_2PI)
"""Density of their slope, as of a normal distribution with a sigma of two degrees."""


def level_errors(dem: Dem, config: LocatingConfig) -> tuple[Float64Array, Float64Array]:
    """By raster of the terrain, (L,): variance of heights, and metres from which their errors are independent."""
    resolutions = np.array([level.geometry.resolution for level in dem.levels])
    return np.maximum(config.dem_sigma, LEVEL_SHARE * resolutions) ** 2, APART_CELLS * resolutions


@dataclass(frozen=True, eq=False)
class SightLikelihood:
    """Of the samples of a fan, (A, R) each. `density`: of the marked direction. `fit`: that over the greatest that the
    sample could have, were the mark where it is best for it: 1 where all agrees. `lifts`: metres above the ground from
    which something is seen.
    """

    density: Float64Array
    fit: Float32Array
    lifts: Float32Array


def sight_likelihood(
    fan: SightFan,
    table: DirectionTable,
    height: float,
    bend: float,
    variances: Float64Array,
    apart: Float64Array,
    smoke: bool,
    lean: float = 0.0,
    turned: bool = False,
) -> SightLikelihood:
    """What the mark says of each sample.

    Args:
        height: of the camera, metres.
        variances: of the terrain's heights, by raster of the stack, square metres.
        apart: metres from which errors of these heights are independent, by raster.
        smoke: what is marked is the lowest visible part of smoke, not something on the ground.
        lean: of a plume, `LocatingConfig.plume_lean`.
        turned: the table is of a camera that is turned (`turned_table`).
    """
    shape = fan.heights.shape
    knots = np.clip(np.searchsorted(KNOTS, fan.ranges), 0, len(KNOTS) - 1)
    terrain = RayTerrain(fan.heights, fan.levels, fan.ranges, knots, height, bend)
    marked = RayMark(table.density[0], table.slope, table.variance)
    density, fit, lifts = np.zeros(shape), np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    if not smoke:
        ground_along(terrain, marked, variances, density, fit, lifts)
    else:
        hidden, hidden_fit, unseen = np.zeros(shape), np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        found = SmokeDensities(density, hidden, fit, hidden_fit, unseen, lifts)
        rise = math.inf if turned or lean <= 0 else NEXT_DRIFT[0] / lean
        smoke_along(terrain, marked, HeightErrors(variances, apart), rise, found)
        if turned:
            add_smeared(terrain, marked, fan.azimuths, lean, found)
        else:
            drifting = Drifts(fan.widths, table.density, table.density.max(axis=1), lean, NEXT_DRIFT)
            add_drifted(terrain, marked, drifting, found)
            return SightLikelihood(density, fit, lifts)
    azimuth = table.density[0][:, knots]
    if turned:
        known = np.isfinite(fan.heights)
        density = (1 - OTHERWISE) * density + OTHERWISE * known * OTHER_SLOPE
        fit = np.where(known, np.maximum(fit, OTHERWISE), 0.0).astype(np.float32)
    peak = table.density[0].max(axis=0)[knots]
    return SightLikelihood(density * azimuth, (fit * (azimuth / peak)).astype(np.float32), lifts)
