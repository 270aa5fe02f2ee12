"""Heights of stands from depth against bare earth, for sites without a raster of tree tops.

There the terrain map takes what the first agreeing views measured in a cell for its canopy. Of a fuel cell, the height
is the mean of those cells that stand.
"""

from __future__ import annotations

import numpy as np

from ltm_core.fuel.seen_canopy import ALIKE, TALL
from ltm_core.grid import GridGeometry
from ltm_core.terrain.surface_map import SurfaceMap
from ltm_core.types import Float32Array

_STRIP = 256
"""Rows of the terrain that are worked on at a time."""
_LEAST_SHARE = 0.1
"""Of a fuel cell that must have been seen as standing."""


def stand_heights(surface: SurfaceMap, fuel: GridGeometry) -> tuple[Float32Array, Float32Array]:
    """Of the cells of a fuel grid (in the map frame): mean height of what stands 2 m and more over bare earth where
    independent views have measured it, and its standard error, metres; NaN where hardly anything was seen to stand.
    """
    size = fuel.width * fuel.height
    count, total, squares, noise = (np.zeros(size) for _ in range(4))
    top, left, height, width = surface.seen_window() or (0, 0, 0, 0)
    for row in range(top, top + height, _STRIP):
        layers = surface.layers((row, left, min(_STRIP, top + height - row), width))
        above = layers.height - layers.bare
        rows, cols = np.nonzero(layers.observed & (above >= TALL))
        to_row, to_col = fuel.cell_of(*layers.geometry.to_map(rows, cols))
        inside = fuel.contains(to_row, to_col)
        place, value = (to_row * fuel.width + to_col)[inside], above[rows, cols][inside].astype(np.float64)
        sigma = layers.sigma[rows, cols][inside].astype(np.float64)
        for sums, part in ((count, None), (total, value), (squares, value**2), (noise, sigma)):
            sums += np.bincount(place, part, size)
    ratio = (fuel.resolution / surface.reference.geometry.resolution) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = total / count
        spread = np.maximum(squares / count - mean**2, 0.0)
        independent = np.maximum(count / ratio * (fuel.resolution / ALIKE) ** 2, 1.0)
        # What cameras measure errs alike over a stand.
        sigmas = np.sqrt(spread / independent + (noise / count) ** 2)
    known = count >= _LEAST_SHARE * ratio
    return (
        np.where(known, mean, np.nan).reshape(fuel.shape).astype(np.float32),
        np.where(known, sigmas, np.nan).reshape(fuel.shape).astype(np.float32),
    )
