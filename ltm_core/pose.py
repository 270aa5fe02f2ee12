"""Camera poses: `from ltm_core.pose import Pose`."""

from ltm_core.geometry.pose import Pose

__all__ = ["Pose"]
