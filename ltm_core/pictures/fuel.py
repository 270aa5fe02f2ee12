"""Pictures of a fuel map: its life forms over relief, paler where they are less sure, changed cells outlined."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ltm_core.fuel.decision import FuelLayers
from ltm_core.fuel.life_form import LifeForm
from ltm_core.vision.labels import LabelSet

_BURNED = (40, 32, 30)
_UNKNOWN = (235, 235, 232)
_CHANGED = (255, 40, 160)


def fuel_picture(
    layers: FuelLayers, heights: NDArray[np.floating], labels: LabelSet, cell: float, scale: int = 4
) -> NDArray[np.uint8]:
    """(scale H, scale W, 3) RGB of the map over the hillshade of `heights` (H, W), light from the north-west.

    A cell fades with the doubt about its life form; the outlines of changed cells are pink.
    """
    palette = np.full((256, 3), _UNKNOWN, np.float64)
    palette[1 : len(labels)] = labels.colors[1:]
    palette[LifeForm.BURNED] = _BURNED
    sure = np.clip(2 * np.nan_to_num(layers.p_max, nan=0.5) - 1, 0, 1)[..., None]
    color = np.array(_UNKNOWN) + (0.35 + 0.65 * sure) * (palette[layers.life_form] - np.array(_UNKNOWN))
    big = color.repeat(scale, axis=0).repeat(scale, axis=1)
    known = np.isfinite(heights)
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    filled = heights[tuple(nearest)] if known.any() else np.zeros(heights.shape)
    smooth = ndimage.zoom(filled, scale, order=1, mode="nearest", grid_mode=True)
    south, east = np.gradient(smooth, cell / scale)
    light = (-east * -0.5 + -south * -0.5 + 0.7) / np.sqrt(1 + east**2 + south**2)
    shaded = big * np.clip(0.55 + 0.6 * light, 0.45, 1.12)[..., None]
    changed = layers.changed.repeat(scale, axis=0).repeat(scale, axis=1)
    outline = changed & ~ndimage.binary_erosion(changed)
    shaded[outline] = _CHANGED
    return np.asarray(np.clip(shaded, 0, 255), np.uint8)
