"""Clouds over a site: bodies of fractal density in a slab of air, lit by sun and sky, with shadows; and high veils.

A function of the seed and of map position alone, so that every camera sees the same sky.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from ltm_core.camera import Camera
from ltm_core.pose import Pose
from ltm_core.simulator.noise import gradient_noise, gradient_noise_3d, lattice_uniform
from ltm_core.simulator.scenario import CloudConfig, SunConfig
from ltm_core.simulator.sky import sun_direction

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Color = NDArray[np.float32]

_EXTINCTION = {"cumulus": 0.045, "stratus": 0.02}  # 1/m where density is 1: a few hundred droplets a cubic centimetre
_SOFT = {"cumulus": 0.26, "stratus": 0.6}  # of the strength's range over which an edge thins out
_BILLOWS = {"cumulus": 0.66, "stratus": 0.5}  # how much of a body billows bite out of it
_FADE = 30_000.0  # m over which far clouds fade into the air
_REACH = 14_000.0  # m of a ray inside the slab beyond which nothing shows
_LEVEL = 0.004  # upward slope of a ray under which it counts as level: haze is all that it sees
_STEPS, _SUN_STEPS, _SHADE_STEPS = 40, 8, 7
_FIELD_OCTAVES, _OCTAVES = 4, 5  # of the map of where clouds are, and of the billows on them
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

    opacity: Image
    sun: Image
    sky: Image

    def over(self, sky: Image, sun_card: Color, sky_card: Color) -> Image:
        """Radiance (..., 3) of the clear `sky` (..., 3) with the clouds before it; the cards' radiance (3,)."""
        body = self.sun[..., None] * _whiter(sun_card) + self.sky[..., None] * _whiter(sky_card)
        return np.asarray(sky * (1 - self.opacity[..., None]) + body, np.float32)


@dataclass(frozen=True)
class Overhead:
    """A cloudy sky as a whole: the share `cover` of its light that clouds send, the `light` (3,) of a level card under
    it in their shade, and that light relative to a clear sky's, `factor` (3,)."""

    cover: float
    light: Color
    factor: Color

    def air(self, clear: Color) -> Color:
        """The colour (3,) of air under these clouds that is `clear` without them."""
        grey = float(self.light @ _LUMINANCE)
        return np.asarray((1 - self.cover) * clear + self.cover * 0.9 * grey, np.float32)


class Clouds:
    """The clouds of a scenario over ground at `datum` metres, as they stand about map point `eye` (3,)."""

    def __init__(self, config: CloudConfig, datum: float, sun: SunConfig, eye: Array, seed: int) -> None:
        self._config = config
        self._slab = np.array([datum + config.base, config.depth])
        self._veil_height = datum + max(_VEIL_HEIGHT, 2 * config.base)
        self._sun = sun_direction(sun)
        self._eye = np.asarray(eye, np.float64)
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

    def strength(self, x: Array, y: Array) -> Array:
        """How strongly clouds form over map points (any shape): none below 0, about 1 in the middle of the largest."""
        flat = _field(np.ravel(np.asarray(x, float)), np.ravel(np.asarray(y, float)), self._config.size, self._seed)
        return np.asarray(((flat - self._shape[1]) / self._shape[2]).reshape(np.shape(x)), np.float64)

    def sunlight(self, points: Array) -> Image:
        """The share of the sun's light that reaches map points (..., 3)."""
        flat = np.ascontiguousarray(points.reshape(-1, 3), np.float64)
        out = np.empty(len(flat), np.float32)
        _shade(flat, self._sun, self._slab, self._shape, self._raster, self._frame, self._seed, out)
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

    def overhead(self, sun_card: Color, sky_card: Color) -> Overhead:
        """What these clouds make of a clear sky's light; the cards' radiance (3,)."""
        k = np.arange(_DOME) + 0.5
        flat, turn = np.sqrt(k / _DOME), k * np.pi * (3 - np.sqrt(5))
        rays = np.stack([flat * np.cos(turn), flat * np.sin(turn), np.sqrt(1 - flat**2)], axis=-1)
        opacity, sun, sky = self._along(rays[None])[0].mean(axis=0)[:, None]
        light = CloudLayer(opacity, sun, sky).over(sky_card[None], sun_card, sky_card)[0]
        return Overhead(float(opacity[0]), light, np.asarray(light / sky_card, np.float32))

    def _along(self, rays: Array) -> Image:
        """(H, W, 3): opacity, sunlight and skylight along unit rays (H, W, 3) from the eye."""
        rows, cols = rays.shape[:2]
        out = np.zeros((rows * cols, 3), np.float32)
        flat = np.ascontiguousarray(rays.reshape(-1, 3))
        _march(flat, self._eye, self._sun, self._slab, self._shape, self._raster, self._frame, self._seed, out)
        layer = out.reshape(rows, cols, 3)
        if self._config.veil > 0:
            layer = self._before_veil(layer, rays)
        # What the drawn starts leave of grain
        return np.asarray(cv2.GaussianBlur(layer, (0, 0), 0.8), np.float32) if rows > 1 else layer

    def _before_veil(self, layer: Image, rays: Array) -> Image:
        """The layer of low clouds before ice clouds drawn out by the wind up there."""
        up = np.maximum(rays[..., 2], _LEVEL)
        t = (self._veil_height - self._eye[2]) / up
        # Streaks run with the wind, here towards east by south, and are bent by its eddies
        x, y = self._eye[0] + t * rays[..., 0], self._eye[1] + t * rays[..., 1]
        along, across = 0.92 * x - 0.39 * y, 0.39 * x + 0.92 * y
        eddy = self._veil_field(along / 2.0, across, 9000.0, 31)
        broad = self._veil_field(along / 1.6, across + 2500 * eddy, 5200.0, 37)
        streaks = self._veil_field(along / 4.5, across + 2500 * eddy, 1500.0, 41)
        amount = np.clip(0.45 + 1.3 * broad, 0, 1) * np.clip(0.55 + 0.8 * streaks, 0, 1.4)
        thick = self._config.veil * amount * np.minimum(1 / (2 * up), 2.0)  # a slanted path is longer
        opacity = (1 - np.exp(-thick)) * np.exp(-t / (2 * _FADE)) * (rays[..., 2] > _LEVEL)
        forward = _phase(rays @ self._sun, 0.5)
        behind = np.stack([opacity, opacity * np.minimum(0.35 + 0.25 * forward, 1.2), 0.6 * opacity], axis=-1)
        return np.asarray(layer + (1 - layer[..., :1]) * behind, np.float32)

    def _veil_field(self, x: Array, y: Array, size: float, salt: int) -> Array:
        return _field(np.ravel(x), np.ravel(y), size, self._seed + salt).reshape(x.shape)


def _whiter(card: Color) -> Color:
    """A card's colour as many scatterings and a camera's white balance leave it: most of its tint is gone."""
    grey = float(card @ _LUMINANCE)
    return np.asarray(grey * (card / grey) ** 0.4, np.float32)


def _phase(cosine: Array, g: float) -> Array:
    """Henyey and Greenstein's phase function, times 4 pi."""
    return np.asarray((1 - g * g) / (1 + g * g - 2 * g * cosine) ** 1.5, np.float64)


def _field(x: Array, y: Array, size: float, seed: int) -> Array:
    out = np.empty(x.size)
    _field_points(np.ascontiguousarray(x), np.ascontiguousarray(y), float(size), seed, out)
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _field_at(x: float, y: float, size: float, seed: int) -> float:
    total, gain, scale = 0.0, 1.0, 1.0 / size
    for o in range(_FIELD_OCTAVES):
        total += gain * gradient_noise(x * scale + 5.5 * o, y * scale - 3.1 * o, seed + 101 * o)
        gain *= 0.5
        scale *= 2.0
    return total


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _field_points(x: Array, y: Array, size: float, seed: int, out: Array) -> None:
    for i in range(x.size):
        out[i] = _field_at(x[i], y[i], size, seed)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _strength(x: float, y: float, shape: Array, raster: Image, frame: Array, seed: int) -> float:
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
    x: float, y: float, z: float, slab: Array, shape: Array, raster: Image, frame: Array, seed: int, detail: float
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
    sun: Array,
    slab: Array,
    shape: Array,
    raster: Image,
    frame: Array,
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
def _march(
    rays: Array,
    eye: Array,
    sun: Array,
    slab: Array,
    shape: Array,
    raster: Image,
    frame: Array,
    seed: int,
    out: Image,
) -> None:
    """Opacity, sunlight and skylight of the slab along each ray: single scattering forward and, as two streams give it,
    what many scatterings leave."""
    low, high = (slab[0] - eye[2]), (slab[0] + slab[1] - eye[2])
    for i in range(rays.shape[0]):
        rise = rays[i, 2]
        if rise <= _LEVEL or high <= 0.0:
            continue
        start = max(low, 0.0) / rise
        if start > 3.0 * _FADE:
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
            fade = np.exp(-mean_t / opacity / _FADE)
            out[i, 0], out[i, 1], out[i, 2] = opacity * fade, lit * fade, ambient * fade


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _shade(
    points: Array, sun: Array, slab: Array, shape: Array, raster: Image, frame: Array, seed: int, out: Image
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
