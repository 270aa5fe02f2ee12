"""Accuracy of a fuel map against the true map, over the cells that were seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from ltm_core.base.errors import RasterError
from ltm_core.base.types import Int64Array, UInt8Array
from ltm_core.fuel.cell_counts import UNSEEN
from ltm_core.geometry.grid import GridGeometry


@dataclass(frozen=True, eq=False)
class FuelScore:
    """`cells`: of the map. `seen`: with a class and a known truth. `right`: of those.

    `confusion`: (K, K) cells by [true class, mapped class].
    """

    cells: int
    seen: int
    right: int
    confusion: Int64Array


def score_fuel(
    classes: UInt8Array,
    geometry: GridGeometry,
    truth: UInt8Array,
    truth_geometry: GridGeometry,
    class_count: int,
) -> FuelScore:
    """Score a map on the cells that both rasters hold; both in one CRS with coinciding cells.

    Raises RasterError where the grids' cells do not coincide, or their CRSs differ.
    """
    true = on_grid(truth, truth_geometry, geometry)
    both = (classes < class_count) & (true < class_count)
    confusion = np.bincount(
        true[both].astype(np.int64) * class_count + classes[both], minlength=class_count * class_count
    ).reshape(class_count, class_count)
    return FuelScore(classes.size, int(both.sum()), int(np.trace(confusion)), confusion)


def on_grid(truth: UInt8Array, truth_geometry: GridGeometry, geometry: GridGeometry) -> UInt8Array:
    """Classes of `truth_geometry` at the cells of `geometry`, UNSEEN where it has none.

    Raises RasterError where the grids' cells do not coincide, or their CRSs differ.
    """
    crs, truth_crs = geometry.crs, truth_geometry.crs
    if crs != truth_crs and (crs is None or truth_crs is None or CRS(crs) != CRS(truth_crs)):
        raise RasterError(f"fuel map in {crs} cannot be scored against truth in {truth_crs}: warp one to the other")
    row, col = truth_geometry.to_grid(*geometry.to_map(0, 0))
    offset = np.array([row, col])
    if geometry.resolution != truth_geometry.resolution or np.abs(offset - np.round(offset)).max() > 1e-3:
        raise RasterError(f"fuel map on {geometry} cannot be scored against truth on {truth_geometry}: cells differ")
    rows, cols = np.indices(geometry.shape)
    rows, cols = rows + round(float(row)), cols + round(float(col))
    inside = truth_geometry.contains(rows, cols)
    true = np.full(geometry.shape, UNSEEN, np.uint8)
    true[inside] = truth[rows[inside], cols[inside]]
    return true
