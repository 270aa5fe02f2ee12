"""Surface changes -> sensor_msgs/PointCloud2 and nav_msgs/OccupancyGrid.

One point a cell whose kind of change is new: x, y, z float32 (its centre on the updated surface), row, col int32 of
the terrain's grid, change uint8 (0: no longer changed), shift float32 (metres from the reference surface).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from ltm_core.errors import MessageError
from ltm_core.grid import GridGeometry
from ltm_core.named_columns import take
from ltm_core.terrain.change import Changed, ChangeKind
from ltm_core.terrain.layers import SurfaceLayers
from ltm_core.types import Float32Array
from ltm_msgs_py.grid import classes_to_msg
from ltm_msgs_py.pointcloud import columns_to_msg, msg_to_columns

_WHAT = "terrain update"


def changed_to_msg(
    changed: Changed, heights: Float32Array, geometry: GridGeometry, stamp_ns: int, frame_id: str = "map"
) -> PointCloud2:
    """`heights`: (N,) of the updated surface at the changed cells; `geometry`: the terrain's grid."""
    x, y = geometry.to_map(changed.rows, changed.cols)
    columns: dict[str, NDArray[Any]] = {
        "x": x.astype(np.float32),
        "y": y.astype(np.float32),
        "z": heights.astype(np.float32),
        "row": changed.rows.astype(np.int32),
        "col": changed.cols.astype(np.int32),
        "change": changed.kind.astype(np.uint8),
        "shift": changed.shift.astype(np.float32),
    }
    return columns_to_msg(columns, stamp_ns, frame_id, is_dense=bool(np.isfinite(heights).all()))


def msg_to_changed(msg: Any) -> tuple[Changed, Float32Array]:
    """The changed cells, with kind 0 before, and their places (N, 3) x, y, z. Raises MessageError on other fields or
    types, and on kinds of change that there are not."""
    columns = msg_to_columns(msg)
    rows, cols = (take(columns, name, np.int32, _WHAT) for name in ("row", "col"))
    kind = take(columns, "change", np.uint8, _WHAT)
    shift, *place = (take(columns, name, np.float32, _WHAT) for name in ("shift", "x", "y", "z"))
    if (kind > max(ChangeKind)).any():
        raise MessageError(f"{_WHAT}: change is {int(kind.max())}, no kind of change; there are 0 to {max(ChangeKind)}")
    return Changed(rows, cols, np.zeros_like(kind), kind, shift), np.column_stack(place)


def change_to_msg(layers: SurfaceLayers, stamp_ns: int, frame_id: str = "map") -> OccupancyGrid:
    """Kinds of change of a window; -1 where independent views have not looked."""
    return classes_to_msg(layers.told, layers.geometry, stamp_ns, frame_id)
