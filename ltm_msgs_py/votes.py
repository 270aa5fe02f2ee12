"""CellVotes <-> sensor_msgs/PointCloud2.

One point a cell: x, y, z float32 (its centre on the terrain), row, col int32, and one uint32 field a class, named after
it. So votes are sparse, say themselves what they count, and any ROS tool shows them as points.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from ltm_core.errors import MessageError
from ltm_core.fuel.votes import CellVotes
from ltm_core.grid import GridGeometry
from ltm_msgs_py.pointcloud import columns_to_msg, msg_to_columns, take
from ltm_msgs_py.stamp import stamp_of

_PLACE_FIELDS = ("x", "y", "z", "row", "col")


def votes_to_msg(votes: CellVotes, class_names: Sequence[str], frame_id: str = "map") -> PointCloud2:
    """Votes as points; `class_names`: (K,) in the order of the counts' columns.

    Raises MessageError when the names are not K distinct identifiers.
    """
    names = _checked_names(class_names)
    if votes.counts.shape[1] != len(names):
        raise MessageError(
            f"votes of {votes.source} count {votes.counts.shape[1]} classes, {len(names)} are named: {', '.join(names)}"
        )
    centres = votes.centres()
    columns: dict[str, NDArray[Any]] = {axis: centres[:, i] for i, axis in enumerate("xyz")}
    columns["row"] = votes.rows.astype(np.int32)
    columns["col"] = votes.cols.astype(np.int32)
    for k, name in enumerate(names):
        columns[name] = votes.counts[:, k].astype(np.uint32)
    return columns_to_msg(columns, votes.stamp_ns, frame_id, is_dense=bool(np.isfinite(centres).all()))


def msg_to_votes(msg: Any, geometry: GridGeometry, class_names: Sequence[str], source: str) -> CellVotes:
    """Votes over the fuel grid `geometry` of the receiver; `source`: the camera, which only the topic names.

    Raises MessageError when fields are missing, foreign or of another type, sizes contradict each other, a cell
    lies outside the grid, comes twice or out of row-major order, or its x, y is not the centre of its row, col:
    then the sender counts on another grid.
    """
    names = _checked_names(class_names)
    what = f"votes of {source}"
    columns = msg_to_columns(msg)
    if foreign := sorted(columns.keys() - {*_PLACE_FIELDS, *names}):
        raise MessageError(f"{what} have the fields {', '.join(foreign)}; classes here are {', '.join(names)}")
    x, y, z = (take(columns, axis, np.float32, what) for axis in "xyz")
    rows, cols = (take(columns, index, np.int32, what) for index in ("row", "col"))
    counts = np.column_stack([take(columns, name, np.uint32, what) for name in names])
    inside = geometry.contains(rows, cols)
    if not inside.all():
        first = int(np.argmin(inside))
        raise MessageError(
            f"{what}: point {first} is cell ({rows[first]}, {cols[first]}), outside a fuel grid "
            f"of {geometry.shape} cells"
        )
    cells = rows.astype(np.int64) * geometry.width + cols
    if len(cells) > 1 and np.diff(cells).min() <= 0:
        first = int(np.argmax(np.diff(cells) <= 0)) + 1
        raise MessageError(
            f"{what}: point {first} is cell ({rows[first]}, {cols[first]}), which comes twice or out of row-major order"
        )
    x_here, y_here = geometry.to_map(rows, cols)
    agree = np.maximum(np.abs(x - x_here), np.abs(y - y_here)) <= 0.01 * geometry.resolution
    if not agree.all():
        first = int(np.argmin(agree))
        raise MessageError(
            f"{what}: cell ({rows[first]}, {cols[first]}) stands at ({x[first]}, {y[first]}), here it is at "
            f"({x_here[first]}, {y_here[first]}): sender and receiver use different fuel grids"
        )
    return CellVotes(geometry, rows, cols, counts, z, stamp_of(msg), source)


def _checked_names(class_names: Sequence[str]) -> tuple[str, ...]:
    names = tuple(class_names)
    bad = [n for n in names if n in _PLACE_FIELDS or not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", n)]
    if not names or bad or len(set(names)) != len(names):
        raise MessageError(
            f"vote classes must be distinct identifiers other than {', '.join(_PLACE_FIELDS)}; got {names}"
        )
    return names
