"""Chooses which frames leave an outbox that is full: the oldest are thinned, so that no view is lost while one can be
kept.

Frames of one view of one camera, taken shortly after each other, say nearly the same. So every other one of the older
half goes, then of what is left again: the longer ago, the fewer frames, and the first of each view stays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ltm_core.types import BoolArray, Int64Array


def thinned(stamps_ns: Int64Array, views: NDArray[np.integer], sizes: Int64Array, spare: int) -> BoolArray:
    """Which of N frames go, so that `spare` bytes or more are free; all of them where they hold less.

    `stamps_ns`, `sizes`: (N,) int64, bytes. `views`: (N,) a number for each view of each camera. The result is a mask
    in the order given.
    """
    order = np.argsort(stamps_ns, kind="stable")
    gone = np.zeros(len(order), np.bool_)
    while int(sizes[gone].sum()) < spare:
        left = order[~gone[order]]
        older = left[: (len(left) + 1) // 2]
        chosen = older[_every_other(views[older])]
        if not len(chosen):
            chosen = left[_every_other(views[left])]
        if not len(chosen):
            # One frame of each view is left: the oldest views go.
            freed = np.cumsum(sizes[left]) + int(sizes[gone].sum())
            chosen = left[: int(np.searchsorted(freed, spare)) + 1]
        if not len(chosen):
            break
        gone[chosen] = True
    return gone


def _every_other(views: NDArray[np.integer]) -> BoolArray:
    """(N,) the second, fourth, ... of each view, in the order given."""
    by_view = np.argsort(views, kind="stable")
    ordered = views[by_view]
    begins = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]])) if len(ordered) else np.zeros(0, int)
    lengths = np.diff(np.append(begins, len(ordered)))
    rank = np.arange(len(ordered)) - np.repeat(begins, lengths)
    result = np.zeros(len(views), np.bool_)
    result[by_view] = rank % 2 == 1
    return result
