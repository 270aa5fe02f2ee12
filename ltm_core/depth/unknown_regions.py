"""Unknown pixels that known ground does not enclose stay unknown.

A hole in the DEM has ground all about it, to which the network's scale holds. Land beyond the raster reaches up to the
sky or the image's edge, at any distance, and a network that was fitted to the near ground knows nothing of it.

A union-find over runs of unknown pixels, and not `cv2.connectedComponents`: with that and the sky's dilation the same
answer takes 18 ms of a 1080p frame, a third of all fusion, where this takes 0.5 ms (two cores of an AMD EPYC).
"""

from __future__ import annotations

import numba
import numpy as np

from ltm_core.types import Float32Array, Int32Array, Int64Array, UInt8Array


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def clear_unenclosed(ground: Float32Array, depth: Float32Array, sigma: Float32Array, source: UInt8Array) -> None:
    """Make unknown in `depth`, `sigma` (H, W) and `source` what regions of NaN in the traced `ground` (H, W) cover that
    touch sky or the image's edge, by a corner or more.

    Regions are made of runs of pixels in rows: there are few of them, so that each pixel is looked at once.
    """
    height, width = ground.shape
    rows, starts, ends = _runs(ground)
    count = len(rows)
    parent = np.arange(count)
    open_ended = np.zeros(count, np.bool_)
    previous, first = 0, 0  # the runs of the row above are those from `previous` to `first`
    for k in range(count):
        v, start, end = rows[k], starts[k], ends[k]
        if k == 0 or rows[k - 1] != v:
            previous = first if k and rows[k - 1] == v - 1 else k
            first = k
        open_ended[k] = v == 0 or v == height - 1 or start == 0 or end == width or _sky_beside(ground, v, start, end)
        while previous < first and ends[previous] < start:
            previous += 1
        j = previous
        while j < first and starts[j] <= end:
            a, b = _root(parent, j), _root(parent, k)
            if a != b:
                parent[b] = a
                open_ended[a] |= open_ended[b]
            j += 1
        open_ended[_root(parent, k)] |= open_ended[k]
    for k in range(count):
        if open_ended[_root(parent, k)]:
            v = rows[k]
            for u in range(starts[k], ends[k]):
                if source[v, u] != 0:
                    depth[v, u], sigma[v, u], source[v, u] = np.float32(np.nan), np.float32(np.nan), 0


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _runs(ground: Float32Array) -> tuple[Int32Array, Int32Array, Int32Array]:
    """Row, first column and the column behind the last of every run of NaN, row by row."""
    height, width = ground.shape
    counts = np.zeros(height, np.int32)
    for v in range(height):
        line, before = ground[v, 1:], ground[v, :-1]
        count = np.int32(ground[v, 0] != ground[v, 0])
        for u in range(len(line)):
            count += np.int32((line[u] != line[u]) & (before[u] == before[u]))
        counts[v] = count
    total = counts.sum()
    rows, starts, ends = np.empty(total, np.int32), np.empty(total, np.int32), np.empty(total, np.int32)
    k = 0
    for v in range(height):
        line, u = ground[v], 0
        for _ in range(counts[v]):
            while line[u] == line[u]:
                u += 1
            rows[k], starts[k] = v, u
            while u < width and line[u] != line[u]:
                u += 1
            ends[k] = u
            k += 1
    return rows, starts, ends


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _sky_beside(ground: Float32Array, v: int, start: int, end: int) -> bool:
    """Whether a run that does not touch the image's edge has sky next to it."""
    sky = np.float32(np.inf)
    if ground[v, start - 1] == sky or ground[v, end] == sky:
        return True
    found = False
    for u in range(start - 1, end + 1):
        found |= ground[v - 1, u] == sky or ground[v + 1, u] == sky
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _root(parent: Int64Array, k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k
