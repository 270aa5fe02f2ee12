"""CellVotes <-> sensor_msgs/PointCloud2: one point a cell, with the columns of `ltm_core.fuel.vote_columns` as fields.

So votes are sparse and name the classes that they count, and any ROS tool shows them as points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from sensor_msgs.msg import PointCloud2

from ltm_core.errors import MessageError
from ltm_core.fuel.vote_columns import checked_names, columns_to_votes, most_bytes, votes_to_columns
from ltm_core.fuel.votes import CellVotes
from ltm_core.grid import GridGeometry
from ltm_msgs_py.pointcloud import columns_to_msg, msg_to_columns
from ltm_msgs_py.stamp import stamp_of


def votes_to_msg(votes: CellVotes, class_names: Sequence[str], frame_id: str = "map") -> PointCloud2:
    """Votes as points; `class_names`: (K,) in the order of the counts' columns. Raises MessageError as
    `votes_to_columns` does."""
    columns = votes_to_columns(votes, class_names)
    dense = all(np.isfinite(columns[axis]).all() for axis in ("x", "y", "z"))
    return columns_to_msg(columns, votes.stamp_ns, frame_id, is_dense=dense)


def msg_to_votes(msg: Any, geometry: GridGeometry, class_names: Sequence[str], source: str) -> CellVotes:
    """Votes over the fuel grid `geometry` of the receiver; `source`: the camera, which only the topic names.

    Raises MessageError as `columns_to_votes` does, and when sizes contradict each other or exceed the grid's: such a
    message is refused unread.
    """
    names = checked_names(class_names)
    cells = geometry.width * geometry.height
    most = most_bytes(cells, names)
    if int(msg.height) * int(msg.width) > cells or len(msg.data) > most:
        raise MessageError(
            f"votes of {source} name {int(msg.height) * int(msg.width)} cells in {len(msg.data)} bytes; "
            f"the fuel grid has {cells}, whose votes take {most} bytes at most"
        )
    return columns_to_votes(msg_to_columns(msg), geometry, names, stamp_of(msg), source)
