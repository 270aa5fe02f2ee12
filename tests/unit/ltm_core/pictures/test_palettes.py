import itertools
from typing import Any

import cv2
import numpy as np
import pytest
from skimage.color import deltaE_ciede2000

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


def least(named: dict[str, Any], vision: str) -> tuple[float, str]:
    """The least difference of two colours, and their names."""
    lab = dict(zip(named, seen_as(list(named.values()), vision), strict=True))
    return min((float(deltaE_ciede2000(lab[a], lab[b])), f"{a}, {b}") for a, b in itertools.combinations(named, 2))


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
