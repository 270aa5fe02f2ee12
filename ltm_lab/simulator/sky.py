"""Daylight: the sun's direction, and Mitsuba's sky emitter for it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ltm_core.base.types import Float64Array
from ltm_lab.simulator.scenario import SunConfig


def sun_direction(sun: SunConfig) -> Float64Array:
    """Unit vector (3,) towards the sun, map frame."""
    a, e = np.radians(sun.azimuth_deg), np.radians(sun.elevation_deg)
    return np.array([np.sin(a) * np.cos(e), np.cos(a) * np.cos(e), np.sin(e)])


def daylight(sun: SunConfig) -> dict[str, Any]:
    """Mitsuba's clear sky with its sun (Hosek & Wilkie 2012), for `load_dict`; black below the horizon."""
    return {
        "type": "sunsky",
        "turbidity": sun.turbidity,
        "sun_direction": [float(v) for v in sun_direction(sun)],
        "albedo": 0.2,
    }
