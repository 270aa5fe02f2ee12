"""Which of a camera's pictures are remembered: the newest, and older ones the fewer the older they are."""

from __future__ import annotations

from collections.abc import Sequence

from ltm_core.locating.slip_history import shared_views
from ltm_core.pose_estimation.mount.skyline_turns import SkylineTurns

_ONE_DIRECTION = 0.5
"""Of a view that another one shares, for both to be of one direction."""
_OLDER = 2.0
"""Times as old each older one is as the next, of one direction: a slip's age is taken for log-uniform."""


def remembered(pictures: Sequence[SkylineTurns], most: int) -> list[SkylineTurns]:
    """The newest `most`, and up to as many older ones: they tell whether their directions are to be believed, however
    long ago a camera may have slipped. To be asked with each new picture; oldest first, as given.
    """
    newest, older = list(pictures[-most:]), pictures[:-most]
    if not older:
        return newest
    now, alike = newest[-1].stamp_ns, shared_views(older)
    kept: list[int] = []
    for k, seen in enumerate(older):
        before = [one for one in kept if alike[k, one] > _ONE_DIRECTION]
        if not before or now - older[before[-1]].stamp_ns >= _OLDER * (now - seen.stamp_ns):
            kept.append(k)
    return [*(older[k] for k in kept[-most:]), *newest]
