"""Holes: groups of nodata nodes, and what may be assumed about the ground inside them.

A *node* is a DEM cell centre; a *cell* of the tracer is the square between four nodes, on which the surface is
bilinear. A cell with any NaN node is a hole: its ground is unknown. Two kinds are told apart, because they mean
different things:

* An **enclosed** hole (a lake, a gap in a survey) is surrounded by known ground. Its ground is taken to be no higher
  than its *ceiling*, the highest known node that touches the group of NaN nodes. A ray may pass above the ceiling,
  not below it.
* An **outer** hole reaches the edge of the raster (the margin of a reprojected or clipped DEM). It has no ceiling; it
  is outside the DEM, as the space beyond the raster is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_TOUCHING = np.ones((3, 3), dtype=bool)


def with_ceilings(elevation: NDArray[np.float32]) -> NDArray[np.float32]:
    """Elevations in which each NaN node of an enclosed hole holds the hole's ceiling; NaN nodes of outer holes stay
    NaN.

    Args:
        elevation: (H, W) float32, metres, NaN where nodata.

    Returns:
        (H, W) float32. The input itself, not a copy, where there is no enclosed hole.
    """
    if not any(np.isnan(row).any() for row in elevation):  # no mask of a whole DEM that needs none
        return elevation
    missing = np.isnan(elevation)
    hole_of_node, _ = ndimage.label(missing, structure=_TOUCHING)
    edge = np.concatenate([hole_of_node[0], hole_of_node[-1], hole_of_node[:, 0], hole_of_node[:, -1]])
    enclosed = missing & ~np.isin(hole_of_node, np.unique(edge[edge > 0]))
    if not enclosed.any():
        return elevation
    highest_neighbour = ndimage.maximum_filter(np.where(missing, np.float32(-np.inf), elevation), footprint=_TOUCHING)
    rows, cols = np.nonzero(enclosed)
    holes, member_of = np.unique(hole_of_node[rows, cols], return_inverse=True)
    ceiling = np.full(holes.size, -np.inf, dtype=np.float32)
    np.maximum.at(ceiling, member_of, highest_neighbour[rows, cols])
    filled = elevation.copy()
    filled[rows, cols] = ceiling[member_of]
    return filled
