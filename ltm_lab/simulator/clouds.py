"""Clouds over a site: bodies of fractal density in a slab of air, lit by sun and sky, with shadows; and high veils.

A function of the seed and of map position alone, so that every camera sees the same sky.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.cloud_kernels import FADE, LEVEL, field_points, march, shade
from ltm_lab.simulator.scenario import CloudConfig, SunConfig
from ltm_lab.simulator.sky import sun_direction

_EXTINCTION = {"cumulus": 0.045, "stratus": 0.02}  # 1/m where density is 1: a few hundred droplets a cubic centimetre
_SOFT = {"cumulus": 0.26, "stratus": 0.6}  # of the strength's range over which an edge thins out
_BILLOWS = {"cumulus": 0.66, "stratus": 0.5}  # how much of a body billows bite out of it
_WINDOW, _CELLS = 20_000.0, 26  # m about the eye, and cells a wavelength, of the raster that the strength is read from
_COARSE = 540  # rows above which clouds are drawn on every second pixel: they have no edges that this could blunt
_VEIL_HEIGHT = 6500.0  # m over the site
_HELD = 0.97  # of the sun's light that the thickest cloud keeps from the ground
_NONE = 1e6  # a threshold that nothing reaches
_DOME = 400  # directions that tell what clouds make of the sky's light
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


@dataclass(frozen=True)
class CloudLayer:
    """What rays (...,) see of clouds: `opacity`, and of the light in it the parts that come from the `sun` and from the
    `sky`, each relative to a white card that faces it."""

    opacity: Float32Array
    sun: Float32Array
    sky: Float32Array

    def over(self, sky: Float32Array, sun_card: Float32Array, sky_card: Float32Array) -> Float32Array:
        """Radiance (..., 3) of the clear `sky` (..., 3) with the clouds before it; the cards' radiance (3,)."""
        body = self.sun[..., None] * _whiter(sun_card) + self.sky[..., None] * _whiter(sky_card)
        return np.asarray(sky * (1 - self.opacity[..., None]) + body, np.float32)


@dataclass(frozen=True)
class Overhead:
    """A cloudy sky as a whole: the share `cover` of its light that clouds send, the `light` (3,) of a level card under
    it in their shade, and that light relative to a clear sky's, `factor` (3,)."""

    cover: float
    light: Float32Array
    factor: Float32Array

    def air(self, clear: Float32Array) -> Float32Array:
        """The colour (3,) of air under these clouds that is `clear` without them."""
        grey = float(self.light @ _LUMINANCE)
        return np.asarray((1 - self.cover) * clear + self.cover * 0.9 * grey, np.float32)


class Clouds:
    """The clouds of a scenario over ground at `datum` metres, as they stand about map point `eye` (3,)."""

    def __init__(self, config: CloudConfig, datum: float, sun: SunConfig, eye: Float64Array, seed: int) -> None:
        self._config = config
        self._slab = np.array([datum + config.base, config.depth])
        self._veil_height = datum + max(_VEIL_HEIGHT, 2 * config.base)
        self._sun = sun_direction(sun)
        self._eye = np.array(eye, np.float64)
        self._seed = (seed + 801) & 0x7FFFFFF
        # The threshold that leaves the share `cover` above it, and how far the field rises over it, from a wide sample
        x, y = (a.ravel() * config.size * 0.37 for a in np.meshgrid(np.arange(90.0), np.arange(90.0)))
        field = _field(x, y, config.size, self._seed)
        least, most = np.quantile(field, [1 - config.cover, 1 - 0.05 * config.cover])
        least = least if config.cover > 0 else _NONE
        kind, spread = config.kind, max(most - least, 1e-6)
        self._shape = np.array(
            [config.size, least, spread, _EXTINCTION[kind], _SOFT[kind], _BILLOWS[kind], kind == "stratus"], np.float64
        )
        # Cells of one lattice for all eyes
        cell = config.size / _CELLS
        first = np.floor((self._eye[:2] - _WINDOW) / cell)
        n = int(2 * _WINDOW / cell)
        x, y = np.meshgrid((first[0] + np.arange(n)) * cell, (first[1] + np.arange(n)) * cell)
        self._raster = self.strength(x, y).astype(np.float32)
        self._frame = np.array([first[0] * cell, first[1] * cell, cell])

    def strength(self, x: Float64Array, y: Float64Array) -> Float64Array:
        """How strongly clouds form over map points (any shape): none below 0, about 1 in the middle of the largest."""
        flat = _field(np.ravel(np.asarray(x, float)), np.ravel(np.asarray(y, float)), self._config.size, self._seed)
        return np.asarray(((flat - self._shape[1]) / self._shape[2]).reshape(np.shape(x)), np.float64)

    def sunlight(self, points: Float64Array) -> Float32Array:
        """The share of the sun's light that reaches map points (..., 3)."""
        flat = np.ascontiguousarray(points.reshape(-1, 3), np.float64)
        out = np.empty(len(flat), np.float32)
        shade(flat, self._sun, self._slab, self._shape, self._raster, self._frame, self._seed, out)
        return np.asarray(1 - _HELD * (1 - out.reshape(points.shape[:-1])), np.float32)

    def seen(self, camera: Camera, pose: Pose) -> CloudLayer:
        """The clouds in front of a camera's sky (H, W); below the horizon there are none."""
        step = 2 if camera.height > _COARSE else 1
        rows, cols = (-(-n // step) + (step > 1) for n in (camera.height, camera.width))
        v, u = np.mgrid[0:rows, 0:cols] * float(step)
        local = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
        rays = (local / np.linalg.norm(local, axis=-1, keepdims=True)) @ pose.rotation.T
        layer = self._along(rays)
        if step > 1:
            maps = [np.asarray(m, np.float32) / step for m in np.mgrid[0 : camera.height, 0 : camera.width]]
            layer = cv2.remap(layer, maps[1], maps[0], cv2.INTER_LINEAR)
        return CloudLayer(layer[..., 0], layer[..., 1], layer[..., 2])

    def overhead(self, sun_card: Float32Array, sky_card: Float32Array) -> Overhead:
        """What these clouds make of a clear sky's light; the cards' radiance (3,)."""
        k = np.arange(_DOME) + 0.5
        flat, turn = np.sqrt(k / _DOME), k * np.pi * (3 - np.sqrt(5))
        rays = np.stack([flat * np.cos(turn), flat * np.sin(turn), np.sqrt(1 - flat**2)], axis=-1)
        opacity, sun, sky = self._along(rays[None])[0].mean(axis=0)[:, None]
        light = CloudLayer(opacity, sun, sky).over(sky_card[None], sun_card, sky_card)[0]
        return Overhead(float(opacity[0]), light, np.asarray(light / sky_card, np.float32))

    def _along(self, rays: Float64Array) -> Float32Array:
        """(H, W, 3): opacity, sunlight and skylight along unit rays (H, W, 3) from the eye."""
        rows, cols = rays.shape[:2]
        out = np.zeros((rows * cols, 3), np.float32)
        flat = np.ascontiguousarray(rays.reshape(-1, 3))
        march(flat, self._eye, self._sun, self._slab, self._shape, self._raster, self._frame, self._seed, out)
        layer = out.reshape(rows, cols, 3)
        if self._config.veil > 0:
            layer = self._before_veil(layer, rays)
        # What the drawn starts leave of grain
        return np.asarray(cv2.GaussianBlur(layer, (0, 0), 0.8), np.float32) if rows > 1 else layer

    def _before_veil(self, layer: Float32Array, rays: Float64Array) -> Float32Array:
        """The layer of low clouds before ice clouds drawn out by the wind up there."""
        up = np.maximum(rays[..., 2], LEVEL)
        t = (self._veil_height - self._eye[2]) / up
        # Streaks run with the wind, here towards east by south, and are bent by its eddies
        x, y = self._eye[0] + t * rays[..., 0], self._eye[1] + t * rays[..., 1]
        along, across = 0.92 * x - 0.39 * y, 0.39 * x + 0.92 * y
        eddy = self._veil_field(along / 2.0, across, 9000.0, 31)
        broad = self._veil_field(along / 1.6, across + 2500 * eddy, 5200.0, 37)
        streaks = self._veil_field(along / 4.5, across + 2500 * eddy, 1500.0, 41)
        amount = np.clip(0.45 + 1.3 * broad, 0, 1) * np.clip(0.55 + 0.8 * streaks, 0, 1.4)
        thick = self._config.veil * amount * np.minimum(1 / (2 * up), 2.0)  # a slanted path is longer
        opacity = (1 - np.exp(-thick)) * np.exp(-t / (2 * FADE)) * (rays[..., 2] > LEVEL)
        forward = _phase(rays @ self._sun, 0.5)
        behind = np.stack([opacity, opacity * np.minimum(0.35 + 0.25 * forward, 1.2), 0.6 * opacity], axis=-1)
        return np.asarray(layer + (1 - layer[..., :1]) * behind, np.float32)

    def _veil_field(self, x: Float64Array, y: Float64Array, size: float, salt: int) -> Float64Array:
        return _field(np.ravel(x), np.ravel(y), size, self._seed + salt).reshape(x.shape)


def _whiter(card: Float32Array) -> Float32Array:
    """A card's colour as many scatterings and a camera's white balance leave it: most of its tint is gone."""
    grey = float(card @ _LUMINANCE)
    return np.asarray(grey * (card / grey) ** 0.4, np.float32)


def _phase(cosine: Float64Array, g: float) -> Float64Array:
    """Henyey and Greenstein's phase function, times 4 pi."""
    return np.asarray((1 - g * g) / (1 + g * g - 2 * g * cosine) ** 1.5, np.float64)


def _field(x: Float64Array, y: Float64Array, size: float, seed: int) -> Float64Array:
    out = np.empty(x.size)
    field_points(np.ascontiguousarray(x), np.ascontiguousarray(y), float(size), seed, out)
    return out
