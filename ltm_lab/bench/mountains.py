"""Synthetic mountains of any size at 1 m resolution: the terrain of the benchmarks.

Ridged multifractal of gradient noise (Musgrave, in Ebert et al., Texturing & Modeling, 3rd ed., ch. 16). The field is
endless: a larger raster holds more mountains of the same size, so cost grows only with what a camera can see.
"""

import math

import numpy as np
from numba import njit, prange

from ltm_core.base.types import Float32Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem

_WAVELENGTH = 2100.0  # metres from ridge to ridge
_OCTAVES = 9
_GAIN = 0.40
_HEIGHT = 400.0  # metres


def ridged_terrain(size: int) -> Dem:
    """Return a DEM of `size` x `size` cells of 1 m with its lower-left corner at (0, 0)."""
    elevation = np.empty((size, size), np.float32)
    _fill(elevation)
    return Dem(elevation, GridGeometry(0.0, float(size), 1.0, size, size))


@njit(cache=True, inline="always")  # type: ignore[untyped-decorator]
def _gradient(i: int, j: int, octave: int) -> tuple[float, float]:
    """Return the unit vector of lattice point (i, j)."""
    h = (i * 73856093) ^ (j * 19349663) ^ (octave * 83492791)
    h = ((h ^ (h >> 13)) * 1274126177) & 0x7FFFFFFF
    angle = (h & 0xFFFF) * (2 * math.pi / 65536)
    return math.cos(angle), math.sin(angle)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _noise(x: float, y: float, octave: int) -> float:
    """Return gradient noise in about [-0.7, 0.7]."""
    i, j = math.floor(x), math.floor(y)
    u, v = x - i, y - j
    corners = np.empty(4)
    for k in range(4):
        di, dj = k & 1, k >> 1
        gx, gy = _gradient(int(i) + di, int(j) + dj, octave)
        corners[k] = gx * (u - di) + gy * (v - dj)
    su = u * u * u * (u * (u * 6 - 15) + 10)
    sv = v * v * v * (v * (v * 6 - 15) + 10)
    north = corners[0] + su * (corners[1] - corners[0])
    south = corners[2] + su * (corners[3] - corners[2])
    value: float = north + sv * (south - north)
    return value


@njit(cache=True, parallel=True)  # type: ignore[untyped-decorator]
def _fill(elevation: Float32Array) -> None:
    height, width = elevation.shape
    for row in prange(height):
        for col in range(width):
            total, weight, amplitude, frequency = 0.0, 1.0, 1.0, 1.0 / _WAVELENGTH
            for octave in range(_OCTAVES):
                ridge = 1.0 - abs(_noise(col * frequency, row * frequency, octave)) * 1.6
                ridge *= ridge * weight
                total += ridge * amplitude
                weight = min(max(ridge * 1.7, 0.0), 1.0)
                amplitude *= _GAIN
                frequency *= 2.03
            elevation[row, col] = np.float32(200.0 + _HEIGHT * total)
