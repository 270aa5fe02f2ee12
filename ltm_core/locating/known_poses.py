"""The poses that a camera has told lately: which one a region was marked under."""

from __future__ import annotations

from collections import OrderedDict

from ltm_core.base.types import Float64Array
from ltm_core.geometry.pose import Pose

MOST = 200
"""Poses that are remembered; the one told longest ago goes first."""


class KnownPoses:
    """Poses with covariances (6, 6), by their stamps in nanoseconds."""

    def __init__(self) -> None:
        self._poses: OrderedDict[int, tuple[Pose, Float64Array]] = OrderedDict()

    def __bool__(self) -> bool:
        return bool(self._poses)

    def add(self, stamp: int, pose: Pose, covariance: Float64Array) -> None:
        self._poses[stamp] = (pose, covariance)
        self._poses.move_to_end(stamp)
        while len(self._poses) > MOST:
            self._poses.popitem(last=False)

    @property
    def newest(self) -> tuple[Pose, Float64Array, int]:
        """The one told last, with its stamp. After a clock was set back earlier ones have later stamps, and a head
        looks elsewhere by now. Raises LookupError: none is known."""
        if not self._poses:
            raise LookupError("no pose is known")
        stamp = next(reversed(self._poses))
        return *self._poses[stamp], stamp

    def at(self, stamp: int, age_ns: int) -> tuple[Pose, Float64Array] | None:
        """The pose of a stamp, or the last before it; None: none is known of then, or of `age_ns` before."""
        earlier = [known for known in self._poses if known <= stamp]
        if not earlier or stamp - max(earlier) > age_ns:
            return None
        return self._poses[max(earlier)]
