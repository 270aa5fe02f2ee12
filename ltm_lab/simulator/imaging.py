"""Turns rendered radiance into a photograph: haze, exposure, lens fall-off, tone curve, sensor noise."""

from __future__ import annotations

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_lab.simulator.camera_setup import ImagingConfig
from ltm_lab.simulator.scenario import AtmosphereConfig

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
    if config.denoise:
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
