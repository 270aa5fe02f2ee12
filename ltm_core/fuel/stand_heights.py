"""Heights of stands from depth against bare earth, for sites without a raster of tree tops.

There the terrain map takes what the first agreeing views measured in a cell for its canopy. A cell that a sight meets
half at a crown and half through a gap has a mean of both, which is the height of neither. So of a fuel cell the height
follows from the mean of what stands with each cell's own height as its weight (as Lorey's mean height of a stand has
it): of cells p h high, p the share that crowns had in them, that is the mean of h where p is 0 or 1, and little less
where it is not. It is above that of the canopy from above, since of crowns beside each other the higher are seen.
"""

from __future__ import annotations

import numpy as np

from ltm_core.fuel.seen_canopy import ALIKE, TALL
from ltm_core.grid import GridGeometry
from ltm_core.terrain.surface_map import SurfaceMap
from ltm_core.types import Float32Array, Float64Array

_STRIP = 256
"""Rows of the terrain that are worked on at a time."""
_LEAST_SHARE = 0.1
"""Of a fuel cell that must have been seen as standing."""
_SEEN_ABOVE = 0.8
"""Mean height of a canopy from above by that of what is seen of it from the side, weighted by height; this and what
follows was chosen on rendered sites (docs/exports.md)."""
_SAID = 1 / 3
"""Standard error of a height that a map said before, by that height."""


def stand_heights(surface: SurfaceMap, fuel: GridGeometry, before: Float64Array) -> tuple[Float32Array, Float32Array]:
    """Of the cells of a fuel grid (in the map frame): mean height of what stands 2 m and more over bare earth where
    independent views have measured it, and its standard error, metres; NaN where hardly anything was seen to stand.
    `before` (H, W): what a map said, metres, which meets what was measured by their standard errors; NaN, or too low to
    stand: nothing.
    """
    size = fuel.width * fuel.height
    count, total, squares, cubes, noise = (np.zeros(size) for _ in range(5))
    top, left, height, width = surface.seen_window() or (0, 0, 0, 0)
    for row in range(top, top + height, _STRIP):
        layers = surface.layers((row, left, min(_STRIP, top + height - row), width))
        above = layers.height - layers.bare
        rows, cols = np.nonzero(layers.observed & (above >= TALL))
        to_row, to_col = fuel.cell_of(*layers.geometry.to_map(rows, cols))
        inside = fuel.contains(to_row, to_col)
        place, value = (to_row * fuel.width + to_col)[inside], above[rows, cols][inside].astype(np.float64)
        sigma = layers.sigma[rows, cols][inside].astype(np.float64)
        parts = (count, None), (total, value), (squares, value**2), (cubes, value**3), (noise, value * sigma)
        for sums, part in parts:
            sums += np.bincount(place, part, size)
    ratio = (fuel.resolution / surface.reference.geometry.resolution) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = squares / total
        spread = np.maximum(cubes / total - mean**2, 0.0)
        independent = np.maximum(count / ratio * (fuel.resolution / ALIKE) ** 2, 1.0)
        # What cameras measure errs alike over a stand.
        variance = _SEEN_ABOVE**2 * (spread / independent + (noise / total) ** 2)
        said = np.where(before >= TALL, before, np.nan).ravel()
        trust = 1 / variance, np.nan_to_num(1 / (_SAID * said) ** 2)
        height = (trust[0] * _SEEN_ABOVE * mean + trust[1] * np.nan_to_num(said)) / sum(trust)
        sigmas = 1 / np.sqrt(sum(trust))
    # The weighted mean of what stands is at least TALL; from above it is too.
    height = np.maximum(height, TALL)
    known = count >= _LEAST_SHARE * ratio
    return (
        np.where(known, height, np.nan).reshape(fuel.shape).astype(np.float32),
        np.where(known, sigmas, np.nan).reshape(fuel.shape).astype(np.float32),
    )
