"""Sky where the labels say so: what the terrain cannot tell from land beyond the DEM, the photo can.

A pixel is taken for sky where the traced depth is unknown, the labels call it sky, and everything above it in its
column is sky too: a lake that mirrors the sky, in a hole of the DEM, has known ground or land above it.
"""

from __future__ import annotations

import numba
import numpy as np

from ltm_core.types import Float32Array, UInt8Array


def with_labelled_sky(depth: Float32Array, labels: UInt8Array, sky: int) -> Float32Array:
    """The traced depth (H, W) with +inf for NaN where `labels` (H, W) say so; itself where nothing changes."""
    if not _call_sky(depth, labels, sky, depth[:0]):
        return depth
    called = depth.copy()
    _call_sky(depth, labels, sky, called)
    return called


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _call_sky(depth: Float32Array, labels: UInt8Array, sky: int, called: Float32Array) -> int:
    """Number of such pixels; they are made sky in `called`, unless that is empty."""
    height, width = depth.shape
    below_sky = np.ones(width, np.bool_)
    left, found = width, 0
    for v in range(height):
        if left == 0:
            break
        for u in range(width):
            if not below_sky[u]:
                continue
            d = depth[v, u]
            if labels[v, u] != sky or d < np.float32(np.inf):
                below_sky[u] = False
                left -= 1
            elif d != d:
                found += 1
                if called.size:
                    called[v, u] = np.float32(np.inf)
    return found
