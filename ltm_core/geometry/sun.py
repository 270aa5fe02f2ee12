"""Where the sun stands, for telling day from night by a place and a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ltm_core.base.types import Float64Array

_J2000_S = 946_728_000
"""Seconds from 1970 to noon of 1 January 2000, UTC."""


def sun_elevation(latitude: float, longitude: float, stamps_ns: ArrayLike) -> Float64Array:
    """Of the sun's centre above the horizon, radians, without refraction; right to 0.01 degrees from 1950 to 2050.

    `latitude`, `longitude`: radians, north and east. `stamps_ns`: any shape. Source: J. J. Michalsky, "The Astronomical
    Almanac's algorithm for approximate solar position (1950-2050)", Solar Energy 40 (1988).
    """
    days = np.asarray(stamps_ns, np.float64) / 86_400e9 - _J2000_S / 86_400
    anomaly = np.radians(357.528 + 0.9856003 * days)
    mean_longitude = 280.460 + 0.9856474 * days
    ecliptic = np.radians(mean_longitude + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    tilt = np.radians(23.439 - 4e-7 * days)
    ascension = np.arctan2(np.cos(tilt) * np.sin(ecliptic), np.cos(ecliptic))
    declination = np.arcsin(np.sin(tilt) * np.sin(ecliptic))
    hours = 24 * ((days + 0.5) % 1)
    sidereal = np.radians(15 * (6.697375 + 0.0657098242 * days + hours))
    hour_angle = sidereal + longitude - ascension
    sine = np.sin(declination) * np.sin(latitude) + np.cos(declination) * np.cos(latitude) * np.cos(hour_angle)
    return np.asarray(np.arcsin(np.clip(sine, -1, 1)), np.float64)
