"""Seeded band-limited noise fields on regular grids, in map coordinates.

Every field is a function of (seed, map position), not of the raster it is sampled on: the same patch of ground
has the same value at any resolution.
"""

import numpy as np
from numba import njit

from ltm_core.base.types import Float32Array, Float64Array


@njit(cache=True)  # type: ignore[untyped-decorator]
def lattice_uniform(ix: int, iy: int, seed: int) -> float:
    """Uniform [0, 1) out of a lattice point (integer mix after Murmur3's finaliser)."""
    h = np.uint32((ix * 374761393 + iy * 668265263 + seed * 2246822519) & 0xFFFFFFFF)
    h ^= h >> np.uint32(15)
    h = np.uint32((np.uint64(h) * np.uint64(2246822519)) & np.uint64(0xFFFFFFFF))
    h ^= h >> np.uint32(13)
    h = np.uint32((np.uint64(h) * np.uint64(3266489917)) & np.uint64(0xFFFFFFFF))
    h ^= h >> np.uint32(16)
    return float(h) / 4294967296.0


@njit(cache=True)  # type: ignore[untyped-decorator]
def gradient_noise(x: float, y: float, seed: int) -> float:
    """Perlin's gradient noise, about [-1, 1], zero mean, quintic fade."""
    ix = int(np.floor(x))
    iy = int(np.floor(y))
    fx = x - ix
    fy = y - iy
    u = fx * fx * fx * (fx * (fx * 6.0 - 15.0) + 10.0)
    v = fy * fy * fy * (fy * (fy * 6.0 - 15.0) + 10.0)
    corners = np.empty(4)
    for k in range(4):
        ox = k & 1
        oy = k >> 1
        angle = 2.0 * np.pi * lattice_uniform(ix + ox, iy + oy, seed)
        corners[k] = np.cos(angle) * (fx - ox) + np.sin(angle) * (fy - oy)
    low = corners[0] + u * (corners[1] - corners[0])
    high = corners[2] + u * (corners[3] - corners[2])
    return float(1.4142 * (low + v * (high - low)))


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _fractal_rows(
    xs: Float64Array,
    ys: Float64Array,
    out: Float32Array,
    wavelength: float,
    octaves: int,
    gain: float,
    ridged: bool,
    seed: int,
) -> None:
    for r in range(ys.size):
        for c in range(xs.size):
            total = 0.0
            norm = 0.0
            amplitude = 1.0
            scale = 1.0 / wavelength
            for o in range(octaves):
                n = gradient_noise(xs[c] * scale + 17.3 * o, ys[r] * scale - 9.1 * o, seed + 101 * o)
                if ridged:
                    n = 1.0 - 2.0 * abs(n)
                total += amplitude * n
                norm += amplitude
                amplitude *= gain
                scale *= 2.0
            out[r, c] = total / norm


def fractal(
    xs: Float64Array,
    ys: Float64Array,
    wavelength: float,
    seed: int,
    octaves: int = 4,
    gain: float = 0.5,
    ridged: bool = False,
) -> Float32Array:
    """Fractal noise at the grid ``ys`` x ``xs`` (map metres): (len(ys), len(xs)) float32, about [-1, 1].

    ``wavelength`` is the longest octave's, in metres; ``ridged`` folds each octave into crests.
    """
    out = np.empty((ys.size, xs.size), dtype=np.float32)
    _fractal_rows(
        np.ascontiguousarray(xs, np.float64),
        np.ascontiguousarray(ys, np.float64),
        out,
        float(wavelength),
        octaves,
        gain,
        ridged,
        seed & 0x7FFFFFF,
    )
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _fractal_points(
    x: Float64Array, y: Float64Array, out: Float64Array, wavelength: float, octaves: int, seed: int
) -> None:
    for i in range(x.size):
        a, b = x[i] / wavelength, y[i] / wavelength
        total = 0.0
        norm = 0.0
        gain = 1.0
        scale = 1.0
        for o in range(octaves):
            total += gain * gradient_noise(scale * a + 5.5 * o, scale * b - 3.1 * o, seed + 101 * o)
            norm += gain
            gain *= 0.5
            scale *= 2.0
        out[i] = total / norm


@njit(cache=True)  # type: ignore[untyped-decorator]
def _uniform_points(x: Float64Array, y: Float64Array, out: Float64Array, seed: int) -> None:
    for i in range(x.size):
        out[i] = lattice_uniform(int(np.floor(x[i] * 100.0)), int(np.floor(y[i] * 100.0)), seed)


def at_points(x: Float64Array, y: Float64Array, wavelength: float, seed: int, octaves: int = 2) -> Float64Array:
    """Fractal noise, about [-1, 1], at scattered map points (N,); `wavelength` is the longest octave's."""
    out = np.empty(x.size)
    _fractal_points(
        np.ascontiguousarray(x, np.float64),
        np.ascontiguousarray(y, np.float64),
        out,
        float(wavelength),
        octaves,
        seed & 0x7FFFFFF,
    )
    return out


def uniform_at(x: Float64Array, y: Float64Array, seed: int) -> Float64Array:
    """A uniform number in [0, 1) for each map point (N,), the same whenever that point (to 1 cm) is asked for."""
    out = np.empty(x.size)
    _uniform_points(np.ascontiguousarray(x, np.float64), np.ascontiguousarray(y, np.float64), out, seed & 0x7FFFFFF)
    return out
