"""Blend a fine elevation raster into the coarser one around it, without gaps or steps.

Blends a fine elevation raster into the coarser one around it, without gaps or false steps.

Two surveys of the same ground differ by decimetres to tens of metres (age, datum, smoothing by the coarse cells). The
fine level is therefore fitted into the coarser one, once, when a stack is made:

* **Holes** (NaN nodes, at the raster's margin too) take the coarser surface plus the difference of the two at the
  hole's rim: d = sum(d_k / r_k) / sum(1 / r_k) over the four directions along the grid, with d_k the difference at the
  first known node and r_k its distance; towards a direction in which the raster ends first, d_k is 0 at its edge. This
  is the delta surface fill of Grohman, Kroenung and Strebeck (2006), Photogrammetric Engineering & Remote Sensing
  72(3), with weights along the grid.
* **The border**: within a band of `BAND` coarse cells the fine heights give way to the coarser surface in proportion to
  the distance from the edge, and are equal to it on the outermost nodes.

So on the border both surfaces agree at every fine node, to the rounding of float32; between two fine nodes the coarser
surface may bend where one of its grid lines crosses the border, by at most a quarter of a fine cell times the change of
slope there. The small step that remains is treated as a wall: a ray that comes to it below its upper edge ends there,
so none slips through.
"""

from __future__ import annotations

import numpy as np

from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.grid import GridGeometry

BAND = 3.0
"""Width in coarse cells over which fine heights blend into coarse ones; at most a quarter of the raster."""


def fill_holes(
    fine: Float32Array, fine_geometry: GridGeometry, coarse: Float32Array, coarse_geometry: GridGeometry
) -> None:
    """Fill the holes of `fine` (H, W) from `coarse`, where that is known, in place."""
    from ltm_core.raster.dem_seam_kernels import fill  # here, because most processes of a graph need no numba

    fill(fine, coarse, *_places(fine_geometry, coarse_geometry))


def lead_over(
    fine: Float32Array, fine_geometry: GridGeometry, coarse: Float32Array, coarse_geometry: GridGeometry
) -> None:
    """Lead the border of `fine` (H, W) over to `coarse`, where that is known, in place."""
    from ltm_core.raster.dem_seam_kernels import blend  # here, as above

    band = BAND * coarse_geometry.resolution / fine_geometry.resolution
    blend(fine, coarse, *_places(fine_geometry, coarse_geometry), min(band, (min(fine.shape) - 1) / 4))


def _places(fine: GridGeometry, coarse: GridGeometry) -> tuple[Float64Array, Float64Array]:
    """Return where the fine rows and columns lie in the coarse raster."""
    x, _ = fine.to_map(0, np.arange(fine.width))
    _, y = fine.to_map(np.arange(fine.height), 0)
    rows, _ = coarse.to_grid(coarse.x_min, y)
    _, cols = coarse.to_grid(x, coarse.y_max)
    return rows, cols
