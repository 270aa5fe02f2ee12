"""Points with colour and label <-> sensor_msgs/PointCloud2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from ltm_core.errors import MessageError
from ltm_msgs_py.pointcloud import columns_to_msg, msg_to_columns, take

Bytes = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Points:
    """`xyz`: (N, 3) float32 metres. `rgb`: (N, 3) uint8 or None. `label`: (N,) uint8 or None."""

    xyz: NDArray[np.float32]
    rgb: Bytes | None = None
    label: Bytes | None = None


def points_to_msg(
    xyz: NDArray[np.float32],
    stamp_ns: int,
    frame_id: str,
    rgb: Bytes | None = None,
    label: Bytes | None = None,
) -> PointCloud2:
    """Points (N, 3) float32 with an optional colour (N, 3) uint8 and label (N,) uint8.

    Colour goes as PCL's `rgb`: 0x00RRGGBB in the bits of a float32. Raises MessageError on other shapes or dtypes.
    """
    xyz = np.asarray(xyz)
    count = len(xyz)
    if xyz.shape != (count, 3) or xyz.dtype != np.float32:
        raise MessageError(f"points must be (N, 3) float32, got {xyz.shape} {xyz.dtype}")
    columns: dict[str, NDArray[Any]] = {axis: xyz[:, i] for i, axis in enumerate("xyz")}
    if rgb is not None:
        if rgb.shape != (count, 3) or rgb.dtype != np.uint8:
            raise MessageError(f"point colours must be ({count}, 3) uint8, got {rgb.shape} {rgb.dtype}")
        red, green, blue = rgb.astype(np.uint32).T
        columns["rgb"] = (red << 16 | green << 8 | blue).view(np.float32)
    if label is not None:
        if label.shape != (count,) or label.dtype != np.uint8:
            raise MessageError(f"point labels must be ({count},) uint8, got {label.shape} {label.dtype}")
        columns["label"] = label
    return columns_to_msg(columns, stamp_ns, frame_id, is_dense=bool(np.isfinite(xyz).all()))


def msg_to_points(msg: Any) -> Points:
    """The points of a PointCloud2 with x, y, z float32, and its `rgb` (float32 or uint32) and `label` (uint8) if any.

    Other fields are left aside. Raises MessageError on a field of another type and as `msg_to_columns` does.
    """
    columns = msg_to_columns(msg)
    xyz = np.column_stack([take(columns, axis, np.float32, "point cloud") for axis in "xyz"])
    rgb = None
    if "rgb" in columns:
        packed = columns["rgb"]
        if packed.dtype not in (np.float32, np.uint32):
            raise MessageError(f"point cloud: field 'rgb' is {packed.dtype}, must be float32 or uint32")
        bits = packed.view(np.uint32)
        rgb = np.column_stack([bits >> 16 & 255, bits >> 8 & 255, bits & 255]).astype(np.uint8)
    label = take(columns, "label", np.uint8, "point cloud") if "label" in columns else None
    return Points(xyz, rgb, label)
