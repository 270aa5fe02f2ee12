"""Turns rendered radiance into a photograph: smoke, mirrored sky, haze, exposure, lens fall-off, sensor noise."""

from collections.abc import Sequence

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Float64Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator import noise_fields
from ltm_lab.simulator.camera_setup import ImagingConfig
from ltm_lab.simulator.scenario import AtmosphereConfig, SmokeConfig

_TILE = 256  # pixels a side of the pattern of billows in puffs of smoke
_BOUNCE = np.array([0.52, 0.42, 0.30], np.float32)  # light from sunlit ground near by, relative to the sky's


def lit(sun: Float32Array, sky: Float32Array, is_sky: BoolArray) -> Float32Array:
    """Sun and sky together (H, W, 3), the sky's light smoothed and joined by what sunlit ground throws back."""
    scale = max(float(np.median(sky)), 1e-9)
    root = np.sqrt(np.maximum(sky, 0) / scale)
    smooth = np.square(cv2.bilateralFilter(root, 7, 0.55, 1.8)) * scale
    ambient = np.where(is_sky[..., None], sky, smooth * (1 + _BOUNCE))
    return np.asarray(sun + ambient, np.float32)


def add_haze(
    radiance: Float32Array, lengths: list[Float32Array], air: Float32Array, config: AtmosphereConfig
) -> Float32Array:
    """L exp(-b d) + A (1 - exp(-b d)), a channel its own b; `lengths` are several samples of each pixel's distance
    (H, W)."""
    exponent = (1 + config.blue * np.array([-0.5, 0.0, 0.5])) / config.visibility
    transmittance = np.zeros_like(radiance)
    for distance in lengths:
        transmittance += np.exp(-distance[..., None] * exponent).astype(np.float32) / len(lengths)
    return np.asarray(radiance * transmittance + air * (1 - transmittance), np.float32)


def _tone_curve(x: Float32Array) -> Float32Array:
    """Straight in the shadows, rolling off above 0.6 towards 1 (a camera's shoulder)."""
    knee = 0.6
    over = np.maximum(x - knee, 0) / (1 - knee)
    return np.asarray(np.where(x < knee, x, knee + (1 - knee) * (1 - np.exp(-over))), np.float32)


def _srgb(x: Float32Array) -> Float32Array:
    return np.asarray(np.where(x < 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-6) ** (1 / 2.4) - 0.055), np.float32)


def develop(radiance: Float32Array, camera: Camera, config: ImagingConfig, seed: int, is_sky: BoolArray) -> UInt8Array:
    """An sRGB photograph (H, W, 3) uint8: exposed for the land, with vignetting, sharpening and sensor noise
    drawn from `seed`."""
    rng = np.random.default_rng([seed, 3])
    land = radiance[~is_sky] if np.any(~is_sky) else radiance.reshape(-1, 3)
    luminance = land @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    key = float(np.exp(np.mean(np.log(np.maximum(luminance, 1e-6)))))
    sky_level = float(np.median(radiance[is_sky].mean(axis=-1))) if np.any(is_sky) else 0.0
    # A camera meters the land but holds back for a bright sky and for the brightest ground
    bright = float(np.quantile(luminance, 0.97))
    gain = config.exposure * min(
        0.19 / max(key, 1e-6), 0.95 / max(bright, 1e-6), 1.1 / sky_level if sky_level > 0 else np.inf
    )
    image = radiance * gain
    image = _denoised(image)
    u = (np.arange(camera.width) - camera.cx) / camera.fx
    v = (np.arange(camera.height) - camera.cy) / camera.fy
    cos4 = (1 + u[None, :] ** 2 + v[:, None] ** 2) ** -2
    image = image * (1 - config.vignetting * (1 - cos4))[..., None].astype(np.float32)
    image = np.clip(image, 0, 8)
    sigma = config.noise * np.sqrt(2.5e-4 * np.minimum(image, 1) + 2.5e-6)
    image = image + sigma * rng.standard_normal(image.shape, np.float32)
    out = _srgb(np.clip(_tone_curve(np.maximum(image, 0)), 0, 1))
    soft = cv2.GaussianBlur(out, (0, 0), 1.0)
    out = np.clip(out + 0.35 * (out - soft), 0, 1)
    return np.asarray(np.rint(out * 255), np.uint8)


def _denoised(image: Float32Array) -> Float32Array:
    """Fireflies of few light paths taken out: a pixel far above its neighbours is set to their median."""
    median = np.stack([cv2.medianBlur(np.ascontiguousarray(image[..., c]), 3) for c in range(3)], axis=-1)
    hot = image.mean(axis=-1) > 2.5 * median.mean(axis=-1) + 0.05
    return np.where(hot[..., None], median, image).astype(np.float32)


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
