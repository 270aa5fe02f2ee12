"""Make the layers of a surface map as rasters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array, UInt32Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.surface.cell_update import Rules
from ltm_core.surface.change import Window, estimate_variance, mosaic
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.tile_pool import TilePool

_FIELDS = (
    "dz", "looks", "weight", "relative_variance", "pose_variance", "first", "last", "cameras", "frames", "base", "kind",
    "shift", "since",
)  # fmt: skip
_NOT_LOOKED = 255


@dataclass(frozen=True, eq=False)
class SurfaceLayers:
    """Rasters (H, W) of a window of the grid, in the map frame.

    `bare`, `reference`: metres, as they were given. `height`: the updated surface: the reference (with the canopy that
    the first views found, where no surface raster was given), moved where change was accepted. `estimate`: what the
    cameras measured, NaN where independent views have not agreed. `sigma`: of that estimate, NaN in unseen
    cells. `change`: ChangeKind. `observed`: seen by independent views. `frames`: how many saw the cell. `since`:
    s, when an accepted change had been seen, else 0."""

    geometry: GridGeometry
    bare: Float32Array
    reference: Float32Array
    height: Float32Array
    estimate: Float32Array
    sigma: Float32Array
    change: UInt8Array
    observed: BoolArray
    frames: NDArray[np.uint16]
    since: UInt32Array

    @property
    def told(self) -> UInt8Array:
        """Return (H, W) ChangeKind for publication: 255 where independent views have not seen the cell."""
        known = self.observed | (self.change > 0)
        return np.where(known, self.change, np.uint8(_NOT_LOOKED)).astype(np.uint8)


def layers_of(pool: TilePool, reference: Reference, window: Window | None, rules: Rules) -> SurfaceLayers:
    """Return the layers of a window (row, col, height, width); None: the whole grid."""
    height, width = reference.geometry.shape
    window = window or (0, 0, height, width)
    shape = window[2:]
    parts = mosaic(pool.peek, window, _FIELDS)
    part = slice(window[0], window[0] + shape[0]), slice(window[1], window[1] + shape[1])
    bare, surface = reference.bare[part], reference.surface[part]
    if not parts:
        unknown = np.full(shape, np.nan, np.float32)
        return SurfaceLayers(
            reference.geometry.window(*window), bare, surface, surface.copy(), unknown, unknown.copy(),
            np.zeros(shape, np.uint8), np.zeros(shape, np.bool_), np.zeros(shape, np.uint16),
            np.zeros(shape, np.uint32),
        )  # fmt: skip
    variance, _, sure = estimate_variance(parts, rules)
    base = np.nan_to_num(parts["base"])
    seen = parts["looks"] > 0
    return SurfaceLayers(
        reference.geometry.window(*window),
        bare,
        surface,
        (surface + base + parts["shift"]).astype(np.float32),
        np.where(sure, surface + parts["dz"], np.float32(np.nan)).astype(np.float32),
        np.where(seen, np.sqrt(variance), np.float32(np.nan)).astype(np.float32),
        parts["kind"],
        sure,
        parts["frames"],
        parts["since"],
    )
