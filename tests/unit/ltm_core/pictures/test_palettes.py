from __future__ import annotations

import itertools
import math
from typing import Any

import cv2
import numpy as np
import pytest

from ltm_core.base.types import Float64Array
from ltm_core.fuel.codes import FuelSystem, code_color, fuel_models
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.fire_maps import DIFFERENCE, FLAME, FLAME_DIFFERENCE, arrival_scale
from ltm_core.pictures.fuel_maps import CAMERAS, DOUBT, FOOTPRINT, FRAMES, FuelCanvas
from ltm_core.pictures.legend import scale_colors, text_width
from ltm_core.pictures.locating import STATE_COLORS
from ltm_core.pictures.trace import _COUNTS
from ltm_core.raster.dem import Dem
from ltm_core.surface.surface_io import CHANGE_COLORS
from ltm_core.visibility.point_visibility import PointState
from ltm_core.vision.labels import LabelSet

VISIONS = {
    "normal": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
"""Machado, Oliveira and Fernandes (2009), table 1, severity 1.0: matrices of linear RGB."""


def seen_as(colors: Any, vision: str) -> Float64Array:
    """CIELAB (N, 3) of RGB colours (N, 3) as a person with this vision sees them."""
    rgb = np.asarray(colors, np.float64) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear @ np.asarray(VISIONS[vision]).T, 0, 1)
    back = np.where(seen <= 0.0031308, seen * 12.92, 1.055 * seen ** (1 / 2.4) - 0.055)
    return cv2.cvtColor(back.astype(np.float32)[None], cv2.COLOR_RGB2LAB)[0].astype(np.float64)


def ciede2000(one: Float64Array, other: Float64Array) -> float:
    """Sharma, Wu and Dalal (2005)."""
    (l1, a1, b1), (l2, a2, b2) = one, other
    mean = (math.hypot(a1, b1) + math.hypot(a2, b2)) / 2
    g = 0.5 * (1 - math.sqrt(mean**7 / (mean**7 + 25**7)))
    c1, c2 = math.hypot((1 + g) * a1, b1), math.hypot((1 + g) * a2, b2)
    h1, h2 = (math.degrees(math.atan2(b, (1 + g) * a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    turn = 0.0 if c1 * c2 == 0 else (h2 - h1 + 180) % 360 - 180
    hue = h1 + h2 if c1 * c2 == 0 else (h1 + turn / 2) % 360
    dh = 2 * math.sqrt(c1 * c2) * math.sin(math.radians(turn / 2))
    light, chroma = (l1 + l2) / 2, (c1 + c2) / 2
    t = 1 + sum(
        k * math.cos(math.radians(n * hue + at))
        for k, n, at in ((-0.17, 1, -30), (0.24, 2, 0), (0.32, 3, 6), (-0.2, 4, -63))
    )
    sl = 1 + 0.015 * (light - 50) ** 2 / math.sqrt(20 + (light - 50) ** 2)
    sc, sh = 1 + 0.045 * chroma, 1 + 0.015 * chroma * t
    turned = math.sin(math.radians(60 * math.exp(-(((hue - 275) / 25) ** 2))))
    rt = -2 * turned * math.sqrt(chroma**7 / (chroma**7 + 25**7))
    dl, dc = (l2 - l1) / sl, (c2 - c1) / sc
    return math.sqrt(dl**2 + dc**2 + (dh / sh) ** 2 + rt * dc * dh / sh)


def least(named: dict[str, Any], vision: str) -> tuple[float, str]:
    """The least difference of two colours, and their names."""
    lab = dict(zip(named, seen_as(list(named.values()), vision), strict=True))
    return min((ciede2000(lab[a], lab[b]), f"{a}, {b}") for a, b in itertools.combinations(named, 2))


@pytest.mark.parametrize(
    ("one", "other", "expected"),
    [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 2.49, -0.001), (50.0, -2.49, 0.0009), 7.1792),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((2.0776, 0.0795, -1.135), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_the_formula_gives_published_differences(one: Any, other: Any, expected: float) -> None:
    assert ciede2000(np.array(one), np.array(other)) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("vision", VISIONS)
def test_labels_and_life_forms_differ_for_everyone(vision: str) -> None:
    labels = life_form_labels(LabelSet.load())
    worst, pair = least(dict(zip(labels.names, labels.colors, strict=True)), vision)
    print(f"labels and life forms, {vision}: at least {worst:.1f} CIEDE2000 ({pair})")
    assert worst >= 20


@pytest.mark.parametrize("vision", VISIONS)
@pytest.mark.parametrize("name", ["changes of the terrain", "states of places", "counts of views"])
def test_other_classes_differ_for_everyone(name: str, vision: str) -> None:
    colors = {
        "changes of the terrain": {kind.name: color for kind, color in CHANGE_COLORS.items()},
        "states of places": {state.name: STATE_COLORS[state] for state in list(PointState)[:3]},
        "counts of views": dict(zip(_COUNTS.names, _COUNTS.colors, strict=True)),
    }[name]
    worst, pair = least(colors, vision)
    print(f"{name}, {vision}: at least {worst:.1f} CIEDE2000 ({pair})")
    assert worst >= 10


SCALES = {
    "uncertainty": DOUBT, "frames": FRAMES, "cameras": CAMERAS, "footprint": FOOTPRINT, "flame": FLAME,
    "arrival difference": DIFFERENCE, "flame difference": FLAME_DIFFERENCE,
    "arrival": arrival_scale(6.0),
}  # fmt: skip


@pytest.mark.parametrize("vision", VISIONS)
@pytest.mark.parametrize("name", SCALES)
def test_steps_of_scales_differ_for_everyone(name: str, vision: str) -> None:
    scale = SCALES[name]
    worst, pair = least(dict(zip(scale.names, scale.colors, strict=True)), vision)
    print(f"{name}, {vision}: at least {worst:.1f} CIEDE2000 ({pair})")
    assert worst >= 6


@pytest.mark.parametrize("vision", VISIONS)
def test_brightness_alone_orders_depth_and_flames(vision: str) -> None:
    for colors in (scale_colors(), FLAME.colors):
        steps = np.diff(seen_as(colors, vision)[:, 0])
        assert (steps <= 0.2).all(), "near to far, and short to deadly, become darker"
        assert steps.sum() < -60


def test_fuel_models_are_written_because_their_colours_do_not_differ() -> None:
    models = fuel_models()
    for system in FuelSystem:
        named = {models.name(code): code_color(code) for code in sorted(models.codes(system))}
        for vision in VISIONS:
            worst, pair = least(named, vision)
            print(f"{system.value}, {vision}: at least {worst:.1f} CIEDE2000 ({pair}); names are written")
    geometry = GridGeometry(0.0, 480.0, 30.0, 24, 16)
    dem = Dem(np.full((16, 24), 300.0, np.float32), geometry)
    codes = np.full(geometry.shape, 101, np.int16)
    codes[:, 12:] = 182
    canvas = FuelCanvas(geometry, dem, (), geometry.bounds, width=480)
    names = canvas._names(codes[canvas._row, canvas._col])
    assert [name for name, *_ in names] == ["GR1", "TL2"]
    for (name, x, _, _), (left, right) in zip(names, ((0, 240), (240, 480)), strict=True):
        half = text_width(name, 11) / 2
        assert left <= x - half < x + half <= right
