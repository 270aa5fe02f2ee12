"""Smoke columns over a site, and water that mirrors the sky."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator import noise_fields
from ltm_lab.simulator.scenario import SmokeConfig

_TILE = 256  # pixels a side of the pattern of billows in puffs of smoke


def smoke(
    columns: Sequence[SmokeConfig],
    feet: Sequence[float],
    camera: Camera,
    pose: Pose,
    ranges: Float32Array,
    sunlight: float,
    seed: int,
) -> tuple[Float32Array, Float32Array]:
    """Smoke in front of what a frame shows: its radiance times opacity (H, W, 3), and its opacity (H, W).

    `feet`: ground height at each column; `ranges` (H, W) to the surface; `sunlight`: radiance of sunlit white. Puffs
    rise by buoyancy (height grows with the 2/3 power of time), drift with the wind and widen as they rise.
    """
    steps = np.arange(float(_TILE))
    billows = noise_fields.fractal(steps, steps, 0.5 * _TILE, seed + 811, octaves=6, gain=0.62)
    alpha = np.zeros(ranges.shape, np.float32)
    light = np.zeros((*ranges.shape, 3), np.float32)
    puffs = []
    for k, (column, foot) in enumerate(zip(columns, feet, strict=True)):
        rng = np.random.default_rng([seed, 97, k])
        age = np.sort(rng.uniform(0.0, 1.0, column.puffs)) ** 1.2
        rise = column.height * age ** (2 / 3)
        heading = np.radians(column.wind_deg)
        drift = column.drift * age**1.15
        wide = column.width * (0.5 + rise / 60.0) * 0.5
        wander = rng.normal(size=(column.puffs, 3)) * wide[:, None] * 0.8
        at = np.array([column.x, column.y, foot + 2.0]) + wander
        at[:, 0] += drift * np.sin(heading)
        at[:, 1] += drift * np.cos(heading)
        at[:, 2] += rise
        for p, r, a in zip(at, wide * rng.uniform(0.6, 1.3, column.puffs), age, strict=True):
            look = float(rng.uniform(0.8, 1)), rng.integers(_TILE, size=2)
            puffs.append((p, float(r), float(column.thickness * (1 - 0.75 * a)), float(a), look))
    seen = [(np.linalg.norm(p - pose.position), p, *rest) for p, *rest in puffs]
    for distance, p, radius, opacity, age, (bright, first) in sorted(seen, key=lambda s: -s[0]):
        local = pose.rotation.T @ (p - pose.position)
        if local[2] < 2.0:
            continue
        u, v = camera.fx * local[0] / local[2] + camera.cx, camera.fy * local[1] / local[2] + camera.cy
        size = max(camera.fx * radius / local[2], 0.6)
        reach = int(np.ceil(2.4 * size))
        u0, u1 = max(0, int(u) - reach), min(camera.width, int(u) + reach + 1)
        v0, v1 = max(0, int(v) - reach), min(camera.height, int(v) + reach + 1)
        if u0 >= u1 or v0 >= v1:
            continue
        du, dv = np.meshgrid((np.arange(u0, u1) - u) / size, (np.arange(v0, v1) - v) / size)
        # Billows eat into the puff's rim; what of it stands out towards the light is bright
        rows, cols = (
            np.abs((0.2 * _TILE * d + f).astype(int) % (2 * _TILE) - _TILE) % _TILE
            for d, f in ((dv, first[0]), (du, first[1]))
        )
        puff = np.exp(-0.5 * (du**2 + dv**2))
        body = opacity * np.clip(1.6 * puff - 0.35 + 1.1 * billows[rows, cols] * puff, 0, 1)
        body *= ranges[v0:v1, u0:u1] > distance
        shade = np.clip(0.72 - 0.2 * dv + 0.55 * billows[rows, cols], 0.35, 1)
        tone = np.array([0.8, 0.79, 0.78]) * (0.55 + 0.45 * min(1.0, 2.5 * age)) * bright * sunlight
        a = body.astype(np.float32)
        window = (slice(v0, v1), slice(u0, u1))
        light[window] = light[window] * (1 - a[..., None]) + (a * shade)[..., None] * tone
        alpha[window] = alpha[window] * (1 - a) + a
    return light, alpha


def mirrored(
    radiance: Float32Array, water: BoolArray, rays: Float64Array, air: Float32Array, zenith: Float32Array, seed: int
) -> Float32Array:
    """`radiance` (H, W, 3) with the sky mirrored where `water` (H, W) says; `rays` (H, W, 3) unit, map frame.

    Fresnel's reflectance of a rippled surface; the sky runs from `air` over the horizon to `zenith`.
    """
    if not np.any(water):
        return radiance
    rng = np.random.default_rng([seed, 101])
    down = np.clip(-rays[..., 2][water], 0.01, 1)
    ripple = np.abs(down + cv2.blur(0.09 * rng.normal(size=water.shape), (9, 1))[water])
    fresnel = 0.02 + 0.98 * (1 - np.clip(ripple, 0.02, 1)) ** 5
    blend = np.sqrt(np.clip(ripple, 0, 1))[:, None]
    sky = (1 - blend) * air + blend * zenith
    out = radiance.copy()
    out[water] = radiance[water] * (1 - fresnel[:, None]) + sky * fresnel[:, None]
    return out
