"""Compiled loops of `clouds`: cloud density at a point, and light along rays and shadows through it.

A cloudy sky is passed as arrays. `slab`: height of the bases and depth, metres. `shape`: longest wavelength, the
threshold and the spread of the field, extinction, softness of edges, bite of billows, whether a layer. `raster`: the
strength over the lattice `frame` (x, y of its first point, cell). `sun`: unit vector to it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from ltm_core.base.types import Float32Array, Float64Array
from ltm_lab.simulator.noise_fields import gradient_noise, gradient_noise_3d, lattice_uniform

FADE = 30_000.0  # m over which far clouds fade into the air
LEVEL = 0.004  # upward slope of a ray under which it counts as level: haze is all that it sees
_REACH = 14_000.0  # m of a ray inside the slab beyond which nothing shows
_STEPS, _SUN_STEPS, _SHADE_STEPS = 40, 8, 7
_FIELD_OCTAVES, _OCTAVES = 4, 5  # of the map of where clouds are, and of the billows on them


@njit(cache=True)  # type: ignore[untyped-decorator]
def _field_at(x: float, y: float, size: float, seed: int) -> float:
    total, gain, scale = 0.0, 1.0, 1.0 / size
    for o in range(_FIELD_OCTAVES):
        total += gain * gradient_noise(x * scale + 5.5 * o, y * scale - 3.1 * o, seed + 101 * o)
        gain *= 0.5
        scale *= 2.0
    return total


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def field_points(x: Float64Array, y: Float64Array, size: float, seed: int, out: Float64Array) -> None:
    for i in range(x.size):
        out[i] = _field_at(x[i], y[i], size, seed)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _strength(x: float, y: float, shape: Float64Array, raster: Float32Array, frame: Float64Array, seed: int) -> float:
    """The strength, bilinear between the raster's points; outside it out of the noise itself."""
    col, row = (x - frame[0]) / frame[2], (y - frame[1]) / frame[2]
    c, r = int(np.floor(col)), int(np.floor(row))
    if c < 0 or r < 0 or c >= raster.shape[1] - 1 or r >= raster.shape[0] - 1:
        return float((_field_at(x, y, shape[0], seed) - shape[1]) / shape[2])
    fx, fy = col - c, row - r
    low = raster[r, c] * (1 - fx) + raster[r, c + 1] * fx
    high = raster[r + 1, c] * (1 - fx) + raster[r + 1, c + 1] * fx
    return float(low * (1 - fy) + high * fy)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _density(
    x: float,
    y: float,
    z: float,
    slab: Float64Array,
    shape: Float64Array,
    raster: Float32Array,
    frame: Float64Array,
    seed: int,
    detail: float,
) -> float:
    """Density 0 .. 1 at a point: domes on level bases, or lenses, over the field's hills; billows bitten out of them.

    `detail`: the shortest wavelength that counts.
    """
    up = (z - slab[0]) / slab[1]
    if up <= 0.0 or up >= 1.0:
        return 0.0
    s = _strength(x, y, shape, raster, frame, seed)
    if s <= 0.0:
        return 0.0
    s = min(s, 1.3)
    lens, dome = 1.4 * s - 0.9 * (2.0 * up - 1.0) ** 2, s * min(1.0, up / 0.1) - 0.75 * up**1.4
    body = lens if shape[6] > 0.5 else dome
    if body <= 0.0:
        return 0.0
    bite, norm, gain, wavelength = 0.0, 0.0, 1.0, shape[0] / 3.2
    for o in range(_OCTAVES):
        part = gain * min(1.0, wavelength / detail - 1.0)  # the last octave comes in by and by
        if part <= 0.0:
            break
        n = gradient_noise_3d(x / wavelength + 7.7 * o, y / wavelength, 1.25 * z / wavelength - 2.9 * o, seed + 211 + o)
        bite += part * (1.0 - 1.6 * abs(n))
        norm += part
        gain *= 0.55
        wavelength /= 2.1
    if norm > 0.0:
        body -= shape[5] * max(bite / norm, 0.0) * (0.5 + 0.5 * up)
    t = body / shape[4]
    if t <= 0.0:
        return 0.0
    t = min(t, 1.0)
    return float(t * t * (3.0 - 2.0 * t) * (0.55 + 0.45 * up))


@njit(cache=True)  # type: ignore[untyped-decorator]
def _depth_to_sun(
    x: float,
    y: float,
    z: float,
    sun: Float64Array,
    slab: Float64Array,
    shape: Float64Array,
    raster: Float32Array,
    frame: Float64Array,
    seed: int,
    draw: float,
) -> float:
    """Optical depth from a point inside a cloud to the sun, by strides that grow; `draw`: where in them it looks."""
    total, at, stride = 0.0, 0.0, 0.03 * slab[1]
    for _ in range(_SUN_STEPS):
        t = at + draw * stride
        total += stride * _density(
            x + t * sun[0], y + t * sun[1], z + t * sun[2], slab, shape, raster, frame, seed, 0.12 * shape[0]
        )
        at += stride
        stride *= 1.5
    return float(total * shape[3])


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def march(
    rays: Float64Array,
    eye: Float64Array,
    sun: Float64Array,
    slab: Float64Array,
    shape: Float64Array,
    raster: Float32Array,
    frame: Float64Array,
    seed: int,
    out: Float32Array,
) -> None:
    """Opacity, sunlight and skylight of the slab along each ray: single scattering forward and, as two streams give it,
    what many scatterings leave."""
    low, high = (slab[0] - eye[2]), (slab[0] + slab[1] - eye[2])
    for i in range(rays.shape[0]):
        rise = rays[i, 2]
        if rise <= LEVEL or high <= 0.0:
            continue
        start = max(low, 0.0) / rise
        if start > 3.0 * FADE:
            continue
        ds = min(high / rise - start, _REACH) / _STEPS
        cosine = rays[i, 0] * sun[0] + rays[i, 1] * sun[1] + rays[i, 2] * sun[2]
        forward = (1 - 0.36) / (1 + 0.36 - 1.2 * cosine) ** 1.5
        clear, lit, ambient, mean_t = 1.0, 0.0, 0.0, 0.0
        # A seeded start within the first step, else steps show as rings
        draw = lattice_uniform(i, 0, 5)
        t = start + ds * draw
        for _ in range(_STEPS):
            x, y, z = eye[0] + t * rays[i, 0], eye[1] + t * rays[i, 1], eye[2] + t * rise
            d = _density(x, y, z, slab, shape, raster, frame, seed, max(0.7 * ds, 0.002 * t))
            if d > 0.0:
                to_sun = _depth_to_sun(x, y, z, sun, slab, shape, raster, frame, seed, 0.4 + 0.2 * draw)
                up = (z - slab[0]) / slab[1]
                part = clear * (1.0 - np.exp(-shape[3] * d * ds))
                lit += part * (0.09 * forward * np.exp(-to_sun) + 0.72 / (1.0 + 0.16 * to_sun))
                ambient += part * (0.25 + 0.6 * up)
                mean_t += part * t
                clear -= part
                if clear < 0.01:
                    break
            t += ds
        opacity = 1.0 - clear
        if opacity > 0.0:
            fade = np.exp(-mean_t / opacity / FADE)
            out[i, 0], out[i, 1], out[i, 2] = opacity * fade, lit * fade, ambient * fade


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def shade(
    points: Float64Array,
    sun: Float64Array,
    slab: Float64Array,
    shape: Float64Array,
    raster: Float32Array,
    frame: Float64Array,
    seed: int,
    out: Float32Array,
) -> None:
    """The share of sunlight that the slab lets through to each point: what is scattered forward arrives too."""
    detail = 0.12 * shape[0]
    for i in range(points.shape[0]):
        enter = (slab[0] - points[i, 2]) / sun[2]
        ds = slab[1] / sun[2] / _SHADE_STEPS
        depth = 0.0
        for k in range(_SHADE_STEPS):
            t = enter + (k + 0.5) * ds
            x, y, z = points[i, 0] + t * sun[0], points[i, 1] + t * sun[1], points[i, 2] + t * sun[2]
            depth += ds * _density(x, y, z, slab, shape, raster, frame, seed, detail)
        out[i] = np.exp(-0.5 * shape[3] * depth)
