"""Convert surface changes to PointCloud2 and OccupancyGrid."""

from __future__ import annotations

from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from ltm_core.base.errors import MessageError
from ltm_core.base.named_columns import take
from ltm_core.base.types import Float32Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.surface.change import Changed, ChangeKind
from ltm_core.surface.layers import SurfaceLayers
from ltm_msgs_py.grid import classes_to_msg
from ltm_msgs_py.pointcloud import columns_to_msg, msg_to_columns

_WHAT = "terrain update"


def changed_to_msg(
    changed: Changed, heights: Float32Array, geometry: GridGeometry, stamp_ns: int, frame_id: str = "map"
) -> PointCloud2:
    """Return changed cells as points. `heights`: (N,) of the updated surface there; `geometry`: the terrain's grid."""
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
    """Return the changed cells, with kind 0 before, and their places (N, 3) x, y, z. Raises MessageError for other
    fields or types, and for invalid kinds.
    """
    columns = msg_to_columns(msg)
    rows, cols = (take(columns, name, np.int32, _WHAT) for name in ("row", "col"))
    kind = take(columns, "change", np.uint8, _WHAT)
    shift, *place = (take(columns, name, np.float32, _WHAT) for name in ("shift", "x", "y", "z"))
    if (kind > max(ChangeKind)).any():
        raise MessageError(f"{_WHAT}: change is {int(kind.max())}; valid kinds are 0 to {max(ChangeKind)}")
    return Changed(rows, cols, np.zeros_like(kind), kind, shift), np.column_stack(place)


def change_to_msg(layers: SurfaceLayers, stamp_ns: int, frame_id: str = "map") -> OccupancyGrid:
    """Return kinds of change of a window; -1 without independent views."""
    return classes_to_msg(layers.told, layers.geometry, stamp_ns, frame_id)
