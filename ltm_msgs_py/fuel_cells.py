"""Convert fuel cells that cameras have seen to PointCloud2, and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from ltm_core.base.errors import MessageError
from ltm_core.base.named_columns import take
from ltm_core.base.types import Int64Array
from ltm_core.fuel.decision import FuelLayers
from ltm_core.geometry.grid import GridGeometry

_FIELDS: Final[dict[str, Any]] = {
    "life_form": np.uint8,
    "prior": np.int16,
    "code": np.int16,
    "p_max": np.float32,
    "entropy": np.float32,
    "evidence": np.float32,
    "changed": np.uint8,
    "seen_by": np.uint8,
}


@dataclass(frozen=True, eq=False)
class FuelCells:
    """(N,) each: row and col of the fuel grid, and the layers of `FuelLayers` there by name."""

    rows: Int64Array
    cols: Int64Array
    layers: dict[str, NDArray[Any]]

    def raster(self, name: str, shape: tuple[int, int], elsewhere: float | NDArray[Any]) -> NDArray[Any]:
        """Return a layer as (H, W); cells without data get `elsewhere`, a value or (H, W)."""
        whole = np.full(shape, elsewhere, self.layers[name].dtype)
        whole[self.rows, self.cols] = self.layers[name]
        return whole


def fuel_cells_to_msg(
    layers: FuelLayers, heights: NDArray[np.floating], geometry: GridGeometry, stamp_ns: int
) -> PointCloud2:
    """Return the cells with evidence; `heights`: (H, W) metres of the terrain at the cells' centres."""
    rows, cols = np.nonzero((layers.last_seen > 0) | layers.changed)
    x, y = geometry.to_map(rows, cols)
    z = np.asarray(heights[rows, cols], np.float32)
    columns: dict[str, NDArray[Any]] = {"x": x.astype(np.float32), "y": y.astype(np.float32), "z": z}
    columns |= {name: getattr(layers, name)[rows, cols].astype(dtype) for name, dtype in _FIELDS.items()}
    return columns_to_msg(columns, stamp_ns, "map", is_dense=bool(np.isfinite(z).all()))


def msg_to_fuel_cells(msg: Any, geometry: GridGeometry) -> FuelCells:
    """Return fuel cells. Raises MessageError for missing fields or types, more points than the grid has cells, and
    points outside it.
    """
    if int(msg.height) * int(msg.width) > geometry.width * geometry.height:
        raise MessageError(f"fuel cells: {int(msg.height) * int(msg.width)} points for a grid of {geometry.shape}")
    columns = msg_to_columns(msg)
    x, y = (take(columns, axis, np.float32, "fuel cells") for axis in "xy")
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise MessageError("fuel cells: a point has no finite position")
    rows, cols = geometry.cell_of(x, y)
    if not np.all(geometry.contains(rows, cols)):
        raise MessageError(f"fuel cells: a point is outside the fuel grid, {geometry.bounds} in the map frame")
    layers = {name: take(columns, name, dtype, "fuel cells") for name, dtype in _FIELDS.items()}
    return FuelCells(np.asarray(rows, np.int64), np.asarray(cols, np.int64), layers)
