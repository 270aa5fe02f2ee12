"""What one picture's skyline says of a turn of its camera about the vertical: how likely it is, by the angle.

A single skyline need not tell by how much a camera is turned, and who weighs it with other evidence needs more than its
best fit: all angles are asked, each with the pitch and roll that suit it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ltm_core.base.types import Float64Array

TURN_STEP = math.radians(0.1)
TURN_STEPS = 50
"""To either side: what is turned by more is seen at once."""
SKYLINE_TURNS: Float64Array = TURN_STEP * np.arange(-TURN_STEPS, TURN_STEPS + 1, dtype=np.float64)
"""Radians by which a stated azimuth may be too great, (K,)."""


@dataclass(frozen=True, eq=False)
class SkylineTurns:
    """Of one picture. `logs`: (K,) logarithm of how likely its skyline is by SKYLINE_TURNS, against one that shows
    anything. `azimuth`, `hfov`: radians, of the picture as its pose states them: what looks the same way shares the
    terrain model's errors.
    """

    stamp_ns: int
    azimuth: float
    hfov: float
    logs: Float64Array
