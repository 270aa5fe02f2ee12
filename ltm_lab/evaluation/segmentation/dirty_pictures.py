"""Series of pictures as a camera that stands still takes them of one photographed scene, in changing weather, and with
a lens that becomes dirty: for scoring what is told of dirty lenses."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy

import cv2
import numpy as np

from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.vision.dirty_lens import AGREEING, APART_S, HISTORY_APART_S, LEAST_HISTORY, DirtyLens

WIDTH = 480
"""Of the pictures of a series."""
HISTORY_PICTURES, PICTURES = LEAST_HISTORY, AGREEING + 4

Dirt = Callable[[Float32Array], Float32Array]


def told_dirty(
    photo: UInt8Array, seed: int, history: tuple[UInt8Array, ...] = (), dirt: bool = True
) -> dict[str, bool]:
    """Whether a camera that shows `photo` (H, W, 3) tells its lens as dirty, by case of `CASES`. `history`: what it
    showed before, pictures of the same view and size; none: the same photo. `dirt`: else only the first case."""
    rng = np.random.default_rng(seed)
    learnt, now = DirtyLens(), 0.0
    before = [_reduced(picture) for picture in history or (photo,)]
    for number in range(HISTORY_PICTURES):
        learnt.look(_weathered(before[number % len(before)], rng), 0, now)
        now += HISTORY_APART_S
    light, told = _reduced(photo), {}
    for case, lay in CASES.items() if dirt else list(CASES.items())[:1]:
        lens, spoil = deepcopy(learnt), lay(light.shape[:2], rng)
        for number in range(PICTURES):
            lens.look(_weathered(light, rng, spoil), 0, now + APART_S * number)
        told[case] = bool(lens.said())
    return told


def _reduced(photo: UInt8Array) -> Float32Array:
    height, width = photo.shape[:2]
    size = WIDTH, round(height * WIDTH / width)
    return np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA), np.float32)


def _weathered(light: Float32Array, rng: np.random.Generator, spoil: Dirt | None = None) -> UInt8Array:
    """Exposure, shadows of clouds, haze, a mast that shakes by a pixel; then what is on the lens; then a sensor's noise
    and compression."""
    height, width = light.shape[:2]
    shadows = 1.0 - rng.uniform(0.0, 0.5) * _clouds((height, width), rng)
    seen = light * (rng.uniform(0.7, 1.15) * shadows)[..., None].astype(np.float32)
    haze = np.float32(rng.uniform(0.0, 0.25))
    seen = (1 - haze) * seen + haze * _FOG
    shift = np.array([[1, 0, rng.uniform(-1, 1)], [0, 1, rng.uniform(-1, 1)]], np.float32)
    seen = cv2.warpAffine(seen.astype(np.float32), shift, (width, height), borderMode=cv2.BORDER_REPLICATE)
    if spoil is not None:
        seen = spoil(seen)
    seen += np.float32(rng.uniform(1.0, 3.0)) * rng.standard_normal(seen.shape, np.float32)
    noisy = np.clip(seen, 0, 255).astype(np.uint8)
    _, data = cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(80, 93))])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


_FOG = np.array([185.0, 188.0, 192.0], np.float32)


def _clouds(shape: tuple[int, int], rng: np.random.Generator) -> Float32Array:
    """(H, W) in [0, 1], smooth over a fifth of the picture."""
    coarse = rng.random((6, 6)).astype(np.float32)
    field = 2 * cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC) - 0.5
    return np.asarray(np.clip(field, 0, 1), np.float32)


def _clean(shape: tuple[int, int], rng: np.random.Generator) -> Dirt:
    return lambda seen: seen


def _fog_banks(fields: int) -> Callable[..., Dirt]:
    """Fog that hides parts of the scene, and goes from one of so many shapes to the next during the series."""

    def make(shape: tuple[int, int], rng: np.random.Generator) -> Dirt:
        most, banks, turn = rng.uniform(0.7, 0.98), [_clouds(shape, rng) for _ in range(fields)], iter(range(PICTURES))

        def spoil(seen: Float32Array) -> Float32Array:
            at = next(turn) / PICTURES * (fields - 1)
            shape_now = banks[int(at)] * (1 - at % 1) + banks[min(int(at) + 1, fields - 1)] * (at % 1)
            thickness = np.asarray(most * shape_now, np.float32)[..., None]
            return np.asarray((1 - thickness) * seen + thickness * _FOG, np.float32)

        return spoil

    return make


def _drops(count: int, radius: tuple[float, float], blur: tuple[float, float]) -> Callable[..., Dirt]:
    """`radius`, `blur`: shares of the picture's width, from and to."""

    def make(shape: tuple[int, int], rng: np.random.Generator) -> Dirt:
        height, width = shape
        cover = np.zeros(shape, np.float32)
        for _ in range(count):
            centre = int(rng.uniform(0, width)), int(rng.uniform(0, height))
            across = rng.uniform(*radius) * width
            axes = round(across), round(across * rng.uniform(0.8, 1.3))
            cv2.ellipse(cover, centre, axes, float(rng.uniform(0, 180)), 0, 360, 1.0, -1)
        # A drop is close to the lens: its own edge is out of focus.
        cover = cv2.GaussianBlur(cover, (0, 0), 0.006 * width)[..., None]
        sigma, light = rng.uniform(*blur) * width, rng.uniform(0.85, 1.1)

        def spoil(seen: Float32Array) -> Float32Array:
            through = light * cv2.GaussianBlur(seen, (0, 0), sigma)
            return np.asarray((1 - cover) * seen + cover * through, np.float32)

        return spoil

    return make


def _smear(shape: tuple[int, int], rng: np.random.Generator) -> Dirt:
    """Grease, wiped over a band of the picture: blurred along it, and pale."""
    height, width = shape
    angle, place = rng.uniform(0, np.pi), rng.uniform(0.3, 0.7, 2)
    rows, columns = np.mgrid[0:height, 0:width]
    across = (columns - place[0] * width) * np.sin(angle) - (rows - place[1] * height) * np.cos(angle)
    half = rng.uniform(0.08, 0.15) * width
    cover = cv2.GaussianBlur((np.abs(across) < half).astype(np.float32), (0, 0), 0.02 * width)[..., None]
    sigma, pale = rng.uniform(0.005, 0.012) * width, rng.uniform(0.0, 0.3)

    def spoil(seen: Float32Array) -> Float32Array:
        through = (1 - pale) * cv2.GaussianBlur(seen, (0, 0), sigma) + pale * _FOG
        return np.asarray((1 - cover) * seen + cover * through, np.float32)

    return spoil


def _dust(shape: tuple[int, int], rng: np.random.Generator) -> Dirt:
    """A thin film all over: the whole picture a little paler and a little softer."""
    pale, sigma = rng.uniform(0.2, 0.4), 0.0015 * shape[1]
    return lambda seen: np.asarray((1 - pale) * cv2.GaussianBlur(seen, (0, 0), sigma) + pale * _FOG, np.float32)


CASES: dict[str, Callable[[tuple[int, int], np.random.Generator], Dirt]] = {
    "clean": _clean,
    "clean, banks of fog that drift": _fog_banks(4),
    "clean, a bank of fog that stays": _fog_banks(1),
    "one drop of 6 to 10 % of the width": _drops(1, (0.03, 0.05), (0.008, 0.02)),
    "five drops of 6 to 10 %": _drops(5, (0.03, 0.05), (0.008, 0.02)),
    "twelve drops of 3 to 6 %": _drops(12, (0.015, 0.03), (0.006, 0.015)),
    "three drops of 14 to 24 %": _drops(3, (0.07, 0.12), (0.01, 0.03)),
    "a smear": _smear,
    "a film of dust all over": _dust,
}
"""What happens to the lens. The first three, and nothing else, are clean."""
CLEAN = 3
