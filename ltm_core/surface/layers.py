"""Make the layers of a surface map as rasters."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array, UInt32Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.surface.cell_update import Rules
from ltm_core.surface.change import estimate_variance
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.tile_pool import TilePool, Window

_FIELDS = (
    "dz", "looks", "weight", "relative_variance", "pose_variance", "first", "last", "cameras", "frames", "base", "kind",
    "shift", "since",
)  # fmt: skip
UNSEEN = 255
"""Value in rasters of changes for cells that independent views have not seen."""


@dataclass(frozen=True, eq=False)
class SurfaceLayers:
    """Rasters (H, W) of a window of the grid, in the map frame.

    `bare`, `reference`: metres, as they were given. `height`: the updated surface: the reference (with the canopy that
    the first views found, where no surface raster was given), moved by `shift` where change was accepted. `estimate`:
    what the cameras measured, NaN where independent views have not agreed. `sigma`: of that estimate, NaN in unseen
    cells. `change`: ChangeKind. `observed`: seen by independent views. `frames`: how many saw the cell. `since`:
    s, when an accepted change had been seen, else 0."""

    geometry: GridGeometry
    bare: Float32Array
    reference: Float32Array
    height: Float32Array
    shift: Float32Array
    estimate: Float32Array
    sigma: Float32Array
    change: UInt8Array
    observed: BoolArray
    frames: NDArray[np.uint16]
    since: UInt32Array

    @property
    def judged(self) -> BoolArray:
        """Return the cells of which the map knows whether they have changed."""
        return np.asarray(self.observed | (self.change > 0))

    @property
    def told(self) -> UInt8Array:
        """Return (H, W) ChangeKind for publication: UNSEEN where independent views have not seen the cell."""
        return np.where(self.judged, self.change, np.uint8(UNSEEN)).astype(np.uint8)


def layers_of(pool: TilePool, reference: Reference, window: Window, rules: Rules) -> SurfaceLayers:
    """Return the layers of a window of the grid."""
    parts = pool.mosaic(window, _FIELDS)
    row, col, height, width = window
    bare, surface = (grid[row : row + height, col : col + width] for grid in (reference.bare, reference.surface))
    variance, _, sure = estimate_variance(parts, rules)
    nan, shift = np.float32(np.nan), parts["shift"]
    return SurfaceLayers(
        reference.geometry.window(*window), bare, surface, surface + np.nan_to_num(parts["base"]) + shift, shift,
        np.where(sure, surface + parts["dz"], nan), np.where(parts["looks"] > 0, np.sqrt(variance), nan),
        parts["kind"], sure, parts["frames"], parts["since"],
    )  # fmt: skip
