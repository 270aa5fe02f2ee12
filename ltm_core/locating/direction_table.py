"""Densities of a marked azimuth and what slope is marked there, by the azimuths of a fan: once a query, so that the
kernels over the terrain look up what they need.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ltm_core.locating.directions import KNOTS, MarkedDirections
from ltm_core.types import Float64Array

DRIFTS = np.array([0.0, 0.0015, 0.004, 0.01, 0.025])
"""Radians of sideways drift, sigma, for which azimuths are worked out."""
NEXT_DRIFT = np.concatenate([[DRIFTS[1] / 2], np.sqrt(DRIFTS[1:-1] * DRIFTS[2:])])
TURN_SCALE = math.radians(2.0)
MOST_TURNED = math.radians(15.0)
"""How far a camera may be turned without anybody's knowledge: Cauchy's distribution with this scale, cut off there.
Mounts slip by little more often than by much, and nothing is known of how much."""


@dataclass(frozen=True, eq=False)
class DirectionTable:
    """Marked directions by DRIFTS, azimuth of the fan and knot of range: `density` (D, A, J) of the azimuth; `slope`,
    `variance` (A, J) of the slope there, without drift.
    """

    density: Float64Array
    slope: Float64Array
    variance: Float64Array


def direction_table(directions: MarkedDirections, azimuths: Float64Array, drifting: bool) -> DirectionTable:
    """Each marked place is a normal distribution of azimuth and slope; over the places, the slope's distribution at an
    azimuth is taken by its mean and variance.
    """
    c = directions.covariance
    off = azimuths[:, None, None] - directions.azimuth[None, :, None]
    drifts = DRIFTS if drifting else DRIFTS[:1]
    density = np.zeros((len(drifts), len(azimuths), len(KNOTS)))
    for number, drift in enumerate(drifts):
        variance = c[..., 0, 0] + drift**2
        parts = directions.weights[:, None] / np.sqrt(2 * np.pi * variance) * np.exp(-0.5 * off**2 / variance)
        density[number] = parts.sum(axis=1)
        if number == 0:
            slope = directions.slope[:, None] + c[..., 0, 1] / c[..., 0, 0] * off
            left = c[..., 1, 1] - c[..., 0, 1] ** 2 / c[..., 0, 0]
            with np.errstate(invalid="ignore", divide="ignore"):
                mean = (parts * slope).sum(axis=1) / density[0]
                spread = (parts * (left + slope**2)).sum(axis=1) / density[0] - mean**2
    none = density[0] < 1e-7 * density[0].max()
    density[0][none] = 0.0
    middle, variance = _slope(directions)
    return DirectionTable(density, np.where(none, middle, mean), np.where(none, variance, spread))


def turned_table(directions: MarkedDirections, azimuths: Float64Array) -> DirectionTable:
    """Of a camera that is turned by nobody knows how much: the marked slope, and its azimuth as good as that."""
    middle = float(directions.azimuth @ directions.weights)
    turned = turn_density(directions, azimuths - middle)
    shape = (len(azimuths), len(KNOTS))
    slope, variance = _slope(directions)
    density = np.broadcast_to(turned[:, None], shape)[None].copy()
    return DirectionTable(density, np.full(shape, slope), np.broadcast_to(variance, shape).copy())


def turn_density(directions: MarkedDirections, off: Float64Array) -> Float64Array:
    """Of azimuths that are off the marked one by an angle, of a camera that is turned by nobody knows how much."""
    middle = float(directions.azimuth @ directions.weights)
    spread = float(directions.weights @ (directions.azimuth - middle) ** 2)
    return turn_prior(off, math.sqrt(TURN_SCALE**2 + spread))


def turn_prior(turn: Float64Array, scale: float = TURN_SCALE) -> Float64Array:
    """Density of the angle by which a camera is turned, where one is."""
    return np.asarray(scale / (scale**2 + turn**2) / (2 * math.atan(MOST_TURNED / scale)), np.float64)


def _slope(directions: MarkedDirections) -> tuple[float, Float64Array]:
    """The marked slope, and its variance (J,), over all marked places."""
    slope = float(directions.slope @ directions.weights)
    own = np.asarray(directions.weights @ directions.covariance[..., 1, 1], np.float64)
    return slope, own + float(directions.weights @ (directions.slope - slope) ** 2)
