"""Edges of neighbouring columns that belong to one crest."""

from __future__ import annotations

import numba
import numpy as np

from ltm_core.types import Int32Array


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def smoothed_edge_heights(
    rows: Int32Array, cols: Int32Array, raised: Int32Array, width: int, chain: int, beside: int
) -> Int32Array:
    """The median of the heights of each edge and its neighbours along the same crest: columns are judged one by one.

    `rows`, `cols`: (N,) edges from the lowest row of the image up; `raised`: (N,) pixels; `width`: of the image.
    `chain`: rows between neighbours on one crest; `beside`: neighbours to each side that an edge is smoothed with.
    """
    count = len(rows)
    right, left = np.full(count, -1, np.int32), np.full(count, -1, np.int32)
    # Edges come from the lowest row up; the last one of each column is the nearest candidate for its neighbours.
    latest = np.full(width, -1, np.int32)
    for i in range(count):
        v, u = rows[i], cols[i]
        for side in (-1, 1):
            x = u + side
            if 0 <= x < width and latest[x] >= 0 and abs(rows[latest[x]] - v) <= chain:
                j = latest[x]
                if side < 0:
                    left[i], right[j] = j, i
                else:
                    right[i], left[j] = j, i
        latest[u] = i
    smooth = np.empty(count, np.int32)
    near = np.empty(2 * beside + 1, np.int32)
    for i in range(count):
        near[0] = raised[i]
        n = 1
        for way in (left, right):
            j = way[i]
            for _ in range(beside):
                if j < 0:
                    break
                # Sorted as they come.
                k = n
                while k > 0 and near[k - 1] > raised[j]:
                    near[k] = near[k - 1]
                    k -= 1
                near[k] = raised[j]
                n += 1
                j = way[j]
        smooth[i] = near[n // 2]
    return smooth
