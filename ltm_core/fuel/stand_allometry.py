"""Base and bulk density of conifer crowns, from the cover and height of a stand, by published allometry.

Cruz, Alexander and Wakimoto (2003, Int. J. Wildland Fire 12(1), 39-50) give both for four forest types of western North
America, of the basal area B (m2/ha), the number of stems N (1/ha) and the height H (m):

    ln density = a + b ln B + c ln N,    base = d + e H + f B

B and N follow from cover and height: crowns stand at random, so that N pi r^2 = -ln(1 - cover), their radius r is
0.15 H, and stems are H / 70 thick. These two shares are assumed, and so are the standard errors; what is used is only
how both change from one stand to another, in which the shares all but cancel. Of broadleaved stands it says nothing."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from ltm_core.base.types import BoolArray, Float64Array, Int16Array

BROADLEAVED: Final = (9, 182, 186, 189)
"""Codes of broadleaf litter in both systems (Scott and Burgan 2005: TL2, TL6, TL9)."""
DENSITY_ERROR, BASE_ERROR = 0.4, 0.5
"""Standard error as a share of the value; assumed, because Cruz' plots scatter by about as much around his curves."""
MOST_DENSITY: Final = 0.45
"""Maximum bulk density in kg/m3 of the allometry, unless the map stated more; assumed. Low stands are outside the range
of the data: a stand of 15 m that is now 3 m high would get 8 kg/m3."""
_CROWN_RADIUS: Final = 0.15
_SLENDERNESS: Final = 70.0
_MOST_COVER: Final = 0.95
_LEAST_BASE: Final = 0.05
"""Minimum crown base as a share of the height; below the range of the data, the line would be negative."""


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
    """Crown fuel (...). `base`: height of the crowns' base, m; `density`: canopy bulk density, kg/m3; 0 without
    trees."""

    base: Float64Array
    density: Float64Array


def crown_fuel(cover: Float64Array, height: Float64Array, forest: ForestType) -> CrownFuel:
    """Return the crown fuel of stands with `cover` (...) in % and `height` (...) in metres."""
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
    """Return (...) whether the trees of a code have negligible crown fuel."""
    return np.isin(codes, BROADLEAVED)
