"""Transforms between frames, for tests."""

import numpy as np
from geometry_msgs.msg import TransformStamped

from ltm_core.geometry.pose import Pose
from ltm_msgs_py.stamp import make_header

LINK_OPTICAL = Pose(np.zeros(3), np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]))
"""Pose of an optical frame (x right, y down) in its link (x forward, z up), by REP-103."""


def transform_to_msg(pose: Pose, stamp_ns: int, parent: str, child: str) -> TransformStamped:
    """Return the transform from `parent` to `child`, whose pose in `parent` is given."""
    msg = TransformStamped(header=make_header(stamp_ns, parent), child_frame_id=child)
    move, turn = msg.transform.translation, msg.transform.rotation
    move.x, move.y, move.z = (float(v) for v in pose.position)
    turn.x, turn.y, turn.z, turn.w = pose.quaternion
    return msg
