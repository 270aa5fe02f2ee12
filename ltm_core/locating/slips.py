"""What is known of cameras that are turned, before anything is marked: by how much mounts slip."""

from __future__ import annotations

import math

import numpy as np

from ltm_core.base.types import Float64Array

_MEDIAN = math.radians(1.5)
_SPREAD = 0.8
"""Of a slip's size, which is taken for lognormal: 85 % of slips are of 0.5 to 5 degrees, 2 % above 8. There is no
record of slips to fit: a knock, a loose clamp and a lost encoder step are of degrees, what is less a calibrated pose's
covariance has, and what is more is seen at once."""
LOST = math.log(100.0)
"""By how much likelier a camera is turned, in logarithms, whose node `pose` says that it looks elsewhere: on rendered
frames it said so of 18 of 20 turned cameras, and in none of 544 pictures of others. Less than that, since it says it by
the skylines that count here besides."""


def slip_density(turn: Float64Array, step: float) -> Float64Array:
    """Density a radian of the angle by which a mount has slipped, to either side. `step`: between angles; what is less
    than half of it is not told from it.
    """
    size = np.maximum(np.abs(turn), step / 2)
    bell = np.exp(-0.5 * (np.log(size / _MEDIAN) / _SPREAD) ** 2)
    return np.asarray(bell / (2 * size * _SPREAD * math.sqrt(2 * math.pi)), np.float64)
