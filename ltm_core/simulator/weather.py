"""What floats over a site: clouds with their shadows, columns of smoke; and what lies below: water that mirrors the
sky."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.camera import Camera
from ltm_core.pose import Pose
from ltm_core.simulator import noise
from ltm_core.simulator.scenario import CloudConfig, SmokeConfig, SunConfig
from ltm_core.simulator.sky import sun_direction

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_CLOUD_SHADE = 0.78  # of the sun's light that a cloud's middle keeps back
_CLOUD_FADE = 30_000.0  # m over which far clouds fade into the air
_SOFT = 0.16  # of the noise's range over which a cloud's edge thins out


class Clouds:
    """Fair-weather clouds on a level plane, `base` metres over `datum`; a function of the seed and of map position."""

    def __init__(self, config: CloudConfig, datum: float, sun: SunConfig, seed: int) -> None:
        self._config, self._seed = config, seed + 801
        self._height = datum + config.base
        self._sun = sun_direction(sun)
        # The threshold that leaves the share `cover` above it, from a wide sample
        x, y = (a.ravel() * config.size * 0.37 for a in np.meshgrid(np.arange(90.0), np.arange(90.0)))
        self._least = float(np.quantile(self._noise(x, y), 1 - config.cover))

    def _noise(self, x: Array, y: Array) -> Array:
        return noise.at_points(x, y, self._config.size, self._seed, octaves=6)

    def thickness(self, x: Array, y: Array) -> Array:
        """0 (none) .. 1 (thick) at points of the clouds' plane, any shape."""
        flat = self._noise(np.ravel(x), np.ravel(y)).reshape(np.shape(x))
        t = np.clip((flat - self._least) / _SOFT + 0.5, 0, 1)
        return np.asarray(t * t * (3 - 2 * t), np.float64)

    def sunlight(self, points: Array) -> Image:
        """The share of the sun's light that reaches map points (..., 3)."""
        t = (self._height - points[..., 2]) / self._sun[2]
        shade = self.thickness(points[..., 0] + t * self._sun[0], points[..., 1] + t * self._sun[1])
        return np.asarray(1 - _CLOUD_SHADE * shade, np.float32)

    def over_sky(self, sky: Image, rays: Array, eye: Array) -> Image:
        """Radiance (N, 3) of sky seen along unit `rays` (N, 3) from `eye`, with the clouds in front of it."""
        up = np.maximum(rays[:, 2], 1e-4)
        t = (self._height - eye[2]) / up
        x, y = eye[0] + t * rays[:, 0], eye[1] + t * rays[:, 1]
        thick = self.thickness(x, y)
        # The side towards the sun is thinner light: what stands between it and the sun tells
        beyond = self.thickness(x + 90 * self._sun[0], y + 90 * self._sun[1])
        alpha = np.clip(1.25 * thick, 0, 1) * np.exp(-t / _CLOUD_FADE) * (rays[:, 2] > 0.004)
        white = float(np.quantile(sky.max(axis=1), 0.9)) * 2.1 if len(sky) else 0.0
        body = white * np.array([1.0, 0.985, 0.97]) * (1.0 - 0.42 * (0.55 * thick + 0.45 * beyond))[:, None]
        return np.asarray(sky * (1 - alpha[:, None]) + body * alpha[:, None], np.float32)


def smoke(
    columns: Sequence[SmokeConfig],
    feet: Sequence[float],
    camera: Camera,
    pose: Pose,
    ranges: Image,
    sunlight: float,
    seed: int,
) -> tuple[Image, Image]:
    """Smoke in front of what a frame shows: its radiance times opacity (H, W, 3), and its opacity (H, W).

    `feet`: ground height at each column; `ranges` (H, W) to the surface; `sunlight`: radiance of sunlit white. Puffs
    rise by buoyancy (height grows with the 2/3 power of time), drift with the wind and widen as they rise.
    """
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
            puffs.append((p, float(r), float(column.thickness * (1 - 0.75 * a)), float(a), float(rng.uniform(0.75, 1))))
    seen = [(np.linalg.norm(p - pose.position), p, *rest) for p, *rest in puffs]
    for distance, p, radius, opacity, age, bright in sorted(seen, key=lambda s: -s[0]):
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
        body = opacity * np.exp(-0.5 * (du**2 + dv**2)) * (ranges[v0:v1, u0:u1] > distance)
        shade = 0.62 + 0.38 * np.clip(0.5 - 0.4 * dv, 0, 1)
        tone = np.array([0.8, 0.77, 0.74]) * (0.55 + 0.45 * min(1.0, 2.5 * age)) * bright * sunlight
        a = body.astype(np.float32)
        window = (slice(v0, v1), slice(u0, u1))
        light[window] = light[window] * (1 - a[..., None]) + (a * shade)[..., None] * tone
        alpha[window] = alpha[window] * (1 - a) + a
    return light, alpha


def mirrored(radiance: Image, water: NDArray[np.bool_], rays: Array, air: Image, zenith: Image, seed: int) -> Image:
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
