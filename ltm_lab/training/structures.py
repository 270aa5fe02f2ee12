"""Draws masts, huts, dishes, tanks, roofs and railings into training windows: what towers carry, and no photo shows.

Pictures are float32 RGB (H, W, 3) in 0..1, labels (H, W) uint8; each draws from the generator it is given. Shapes are
drawn at four times the size and brought down, so that their edges are as soft as a lens makes them.
"""

from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.label_heads.labelled_frames import UNKNOWN
from ltm_core.vision.labels import Label

Rng = np.random.Generator
Points = npt.NDArray[np.float64]

_FINER = 4  # drawn so many times larger
_COVERED = 0.5  # of a pixel, from which it is the structure's
_TOUCHED = 0.08  # share of a pixel below which the structure is invisible


class _Sheet:
    """A transparent sheet over a window: colours and how much of each pixel they cover."""

    def __init__(self, shape: tuple[int, ...], rng: Rng) -> None:
        self.height, self.width = shape[0], shape[1]
        self.colour = np.zeros((self.height * _FINER, self.width * _FINER, 3), np.float32)
        self.cover = np.zeros((self.height * _FINER, self.width * _FINER), np.float32)
        self.rng = rng
        self.light = 1.0 if rng.random() < 0.5 else -1.0  # the side that the sun is on

    def line(self, a: Points, b: Points, wide: float, colour: Float32Array) -> None:
        thick = max(1, round(wide * _FINER))
        start, end = _place(a), _place(b)
        cv2.line(self.colour, start, end, colour.tolist(), thick)
        cv2.line(self.cover, start, end, (1.0,), thick)

    def area(self, corners: Points, colour: Float32Array) -> None:
        shape = [np.round(corners * _FINER).astype(np.int32)]
        cv2.fillPoly(self.colour, shape, colour.tolist())
        cv2.fillPoly(self.cover, shape, (1.0,))

    def oval(self, centre: Points, axes: tuple[float, float], angle: float, colour: Float32Array) -> None:
        half = (max(1, round(axes[0] * _FINER)), max(1, round(axes[1] * _FINER)))
        cv2.ellipse(self.colour, _place(centre), half, angle, 0, 360, colour.tolist(), -1)
        cv2.ellipse(self.cover, _place(centre), half, angle, 0, 360, (1.0,), -1)

    def laid_on(self, photo: Float32Array, labels: UInt8Array) -> tuple[Float32Array, UInt8Array]:
        size = (self.width, self.height)
        cover = cv2.resize(self.cover, size, interpolation=cv2.INTER_AREA)
        colour = cv2.resize(self.colour * self.cover[..., None], size, interpolation=cv2.INTER_AREA)
        mixed = np.clip(photo * (1.0 - cover[..., None]) + colour, 0.0, 1.0).astype(np.float32)
        changed = np.where(cover > _TOUCHED, np.uint8(UNKNOWN), labels)
        return mixed, np.where(cover > _COVERED, np.uint8(Label.BUILT), changed)


def _place(point: Points) -> tuple[int, int]:
    return round(float(point[0]) * _FINER), round(float(point[1]) * _FINER)


def with_structures(photo: Float32Array, labels: UInt8Array, rng: Rng) -> tuple[Float32Array, UInt8Array]:
    """One to three structures on the land, or at the picture's lower edge; labels become BUILT there."""
    land = (labels != Label.SKY) & (labels != Label.WATER) & (labels != UNKNOWN)
    if land.mean() < 0.1:
        return photo, labels
    sheet = _Sheet(labels.shape, rng)
    for _ in range(int(rng.integers(1, 4))):
        foot = _foot(land, rng)
        size = labels.shape[1] * float(np.exp(rng.uniform(np.log(0.02), np.log(0.35))))
        shapes: list[Callable[[_Sheet, Points, float], None]] = [_mast, _mast, _pole, _hut, _hut, _dish, _tank]
        shapes[int(rng.integers(len(shapes)))](sheet, foot, size)
    if rng.random() < 0.25:
        _own_roof(sheet)
    return sheet.laid_on(photo, labels)


def _foot(land: BoolArray, rng: Rng) -> Points:
    """A pixel of the land, or one below the picture under land."""
    rows, cols = np.nonzero(land)
    chosen = int(rng.integers(len(rows)))
    if rng.random() < 0.2:
        return np.array([float(cols[chosen]), land.shape[0] * rng.uniform(1.0, 1.3)])
    return np.array([float(cols[chosen]), float(rows[chosen])])


def _paint(rng: Rng) -> Float32Array:
    """White, grey, rust, beige, green or dark paint, in some light."""
    paints = np.array(
        [[0.9, 0.9, 0.88], [0.6, 0.6, 0.6], [0.45, 0.32, 0.25], [0.75, 0.68, 0.55], [0.3, 0.38, 0.3], [0.2, 0.2, 0.22]]
    )
    paint = paints[int(rng.integers(len(paints)))] * rng.uniform(0.45, 1.1) + rng.normal(0.0, 0.03, 3)
    return np.asarray(np.clip(paint, 0.02, 1.0), np.float32)


def _mast(sheet: _Sheet, foot: Points, size: float) -> None:
    """A lattice tower of two to three legs with braces, with antennas or a cabin on it."""
    rng, paint, other = sheet.rng, _paint(sheet.rng), _paint(sheet.rng)
    height, wide = size * rng.uniform(2.0, 5.0), size * rng.uniform(0.15, 0.6)
    top = wide * rng.uniform(0.2, 1.0)
    thick, floors = max(0.4, wide * rng.uniform(0.04, 0.12)), int(rng.integers(4, 14))
    banded = rng.random() < 0.3

    def at(side: float, up: float) -> Points:
        across: float = side * (wide + (top - wide) * up) / 2.0
        return np.asarray(foot + np.array([across, -height * up]), np.float64)

    for floor in range(floors):
        low, high = floor / floors, (floor + 1) / floors
        colour = other if banded and floor % 2 else paint
        for side in (-1.0, 1.0, 0.15):
            shade = np.float32(1.0 if side * sheet.light > 0 else 0.65)
            sheet.line(at(side, low), at(side, high), thick, colour * shade)
        sheet.line(at(-1.0, low), at(1.0, high), thick * 0.6, colour * np.float32(0.8))
        sheet.line(at(1.0, low), at(-1.0, high), thick * 0.6, colour * np.float32(0.8))
    if rng.random() < 0.4:
        _box(sheet, at(0.0, 1.0), max(wide, top) * rng.uniform(1.0, 2.0), paint)
    for _ in range(int(rng.integers(0, 4))):
        place = at(rng.uniform(-1.0, 1.0), rng.uniform(0.4, 1.0))
        radius = wide * rng.uniform(0.2, 0.6)
        sheet.oval(place, (radius, radius * rng.uniform(0.4, 1.0)), rng.uniform(0, 180), _paint(rng))


def _pole(sheet: _Sheet, foot: Points, size: float) -> None:
    """A pole with cross arms, guys or an aerial."""
    rng, paint = sheet.rng, _paint(sheet.rng)
    height, thick = size * rng.uniform(1.5, 4.0), max(0.7, size * rng.uniform(0.02, 0.1))
    top = foot - np.array([size * rng.uniform(-0.05, 0.05), height])
    sheet.line(foot, top, thick, paint)
    for _ in range(int(rng.integers(0, 4))):
        place = foot + (top - foot) * rng.uniform(0.6, 1.0)
        arm = np.array([size * rng.uniform(0.1, 0.5), 0.0])
        sheet.line(place - arm, place + arm, thick * rng.uniform(0.4, 0.9), paint * np.float32(0.8))
    if rng.random() < 0.3:
        _box(sheet, top + np.array([0.0, size * 0.2]), size * rng.uniform(0.15, 0.4), _paint(rng))


def _hut(sheet: _Sheet, foot: Points, size: float) -> None:
    _box(sheet, foot, size, _paint(sheet.rng))


def _box(sheet: _Sheet, foot: Points, size: float, paint: Float32Array) -> None:
    """Two walls and a roof, flat or pitched, with windows and a door."""
    rng = sheet.rng
    split, high, deep = size * rng.uniform(0.3, 0.8), size * rng.uniform(0.3, 0.9), size * rng.uniform(0.0, 0.15)
    left, right = foot + np.array([-split, -deep]), foot + np.array([size - split, -deep])
    up = np.array([0.0, -high])
    bright, dark = np.float32(rng.uniform(0.85, 1.1)), np.float32(rng.uniform(0.45, 0.8))
    walls = (bright, dark) if sheet.light > 0 else (dark, bright)
    sheet.area(np.array([left, foot, foot + up, left + up]), paint * walls[0])
    sheet.area(np.array([foot, right, right + up, foot + up]), paint * walls[1])
    roof, over = _paint(rng), size * rng.uniform(0.0, 0.06)
    out = np.array([over, 0.0])
    if rng.random() < 0.5:
        ridge = foot + up * rng.uniform(1.2, 1.8)
        sheet.area(np.array([left + up - out, foot + up, right + up + out, ridge]), roof)
    else:
        lid = up * (1.0 + rng.uniform(0.03, 0.15))
        back = foot + up + np.array([size - 2.0 * split, -2.0 * deep])
        sheet.area(np.array([left + up - out, foot + up, right + up + out, back]), roof)
        sheet.area(np.array([left + up - out, foot + up, foot + lid, left + lid - out]), roof * np.float32(0.8))
    for _ in range(int(rng.integers(0, 5))):
        start = left + (foot - left) * rng.uniform(0.1, 0.8) + up * rng.uniform(0.2, 0.6)
        wide, tall = split * rng.uniform(0.08, 0.2), high * rng.uniform(0.15, 0.4)
        corners = np.array([[0, 0], [wide, 0], [wide, -tall], [0, -tall]])
        sheet.area(start + corners, np.asarray(paint * np.float32(rng.uniform(0.1, 0.6)), np.float32))


def _dish(sheet: _Sheet, foot: Points, size: float) -> None:
    """A dish on a post: a bright oval with a darker inside."""
    rng, paint = sheet.rng, _paint(sheet.rng)
    radius = size * rng.uniform(0.15, 0.5)
    centre = foot - np.array([0.0, size * rng.uniform(0.3, 1.2)])
    sheet.line(foot, centre, max(0.8, radius * 0.15), paint * np.float32(0.6))
    flat, angle = rng.uniform(0.35, 1.0), rng.uniform(0.0, 180.0)
    sheet.oval(centre, (radius, radius * flat), angle, paint)
    shift = np.array([-sheet.light, 0.4]) * radius * 0.12
    sheet.oval(centre + shift, (radius * 0.8, radius * flat * 0.8), angle, paint * np.float32(rng.uniform(0.6, 0.95)))


def _tank(sheet: _Sheet, foot: Points, size: float) -> None:
    """A round tank: strips from light to dark under an oval lid."""
    rng, paint = sheet.rng, _paint(sheet.rng)
    high, strips = size * rng.uniform(0.3, 1.2), 12
    bulge = size * rng.uniform(0.05, 0.18)
    for k in range(strips):
        a, b = (np.cos(np.pi * (1 - j / strips)) for j in (k, k + 1))
        shade = np.float32(0.75 + 0.3 * sheet.light * (a + b) / 2.0)
        low = [bulge * float(np.sqrt(max(0.0, 1 - v * v))) for v in (a, b)]
        x = [foot[0] + size * v / 2.0 for v in (a, b)]
        corners = [[x[0], foot[1] + low[0]], [x[1], foot[1] + low[1]]]
        corners += [[x[1], foot[1] + low[1] - high], [x[0], foot[1] + low[0] - high]]
        sheet.area(np.array(corners), paint * shade)
    sheet.oval(foot - np.array([0.0, high]), (size / 2.0, bulge), 0.0, paint * np.float32(1.05))


def _own_roof(sheet: _Sheet) -> None:
    """What the camera stands on: a deck or a roof across the lower edge, often with a railing."""
    rng, paint = sheet.rng, _paint(sheet.rng)
    left, right = sheet.height * (1.0 - rng.uniform(-0.1, 0.3, 2))
    ends = sorted(rng.uniform(-0.2, 1.2, 2) * sheet.width)
    if ends[1] - ends[0] < 0.2 * sheet.width:
        return
    a, b = np.array([ends[0], left]), np.array([ends[1], right])
    bottom = float(sheet.height + 2)
    sheet.area(np.array([a, b, [b[0] + 20, bottom], [a[0] - 20, bottom]]), paint)
    for k in range(int(rng.integers(0, 8))):  # seams
        at = a + (b - a) * (k + 0.5) / 8.0
        sheet.line(at, np.array([at[0] + rng.uniform(-40, 40), bottom]), 0.8, paint * np.float32(0.75))
    if rng.random() < 0.5:
        rail, high = _paint(rng), sheet.height * rng.uniform(0.05, 0.25)
        up, thick = np.array([0.0, -high]), max(0.8, high * rng.uniform(0.03, 0.1))
        for level in (0.5, 1.0):
            sheet.line(a + up * level, b + up * level, thick, rail)
        for k in range(int(rng.integers(3, 12)) + 1):
            at = a + (b - a) * k / 8.0
            sheet.line(at, at + up, thick, rail * np.float32(0.85))
