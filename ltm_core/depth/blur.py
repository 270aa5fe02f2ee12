"""A photo blurred where that is asked for: most of a photo is far from what looks at its colours."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Sums = NDArray[np.uint16]

TILE = (32, 64)
"""Rows and columns of the photo that are blurred or left out together."""


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def blurred(rgb: Bytes, tiles: NDArray[np.bool_]) -> Bytes:
    """Means over 5 columns and 3 rows, mirrored about the outermost pixels, to the bit as cv2.blur has them.

    `rgb`: (H, W, 3), at least 2 rows and columns. `tiles`: which to blur; elsewhere, what comes back holds anything.
    """
    height, width = rgb.shape[0], rgb.shape[1]
    color, sums = np.empty_like(rgb), np.empty(3 * (width + 4), np.uint16)
    for v in range(height):
        above, here, below = rgb[abs(v - 1)], rgb[v], rgb[height - 1 - abs(height - 2 - v)]
        wanted = tiles[v // TILE[0]]
        x = 0
        while x < len(wanted):
            first = TILE[1] * x
            while x < len(wanted) and wanted[x]:
                x += 1
            last = min(TILE[1] * x, width)
            x += 1
            if first >= last:
                continue
            # `sums` begins two columns before the first one.
            left, right = max(first - 2, 0), min(last + 2, width)
            _three(
                above[left:right].reshape(-1),
                here[left:right].reshape(-1),
                below[left:right].reshape(-1),
                sums[3 * (left - first + 2) :],
            )
            for u in (first - 2, first - 1, last, last + 1):
                mirrored = width - 1 - abs(width - 1 - abs(u))
                if mirrored != u:
                    to, of = 3 * (u - first + 2), 3 * (mirrored - first + 2)
                    sums[to : to + 3] = sums[of : of + 3]
            _mean(sums, color[v, first:last].reshape(-1))
    return color


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _three(above: Bytes, here: Bytes, below: Bytes, sums: Sums) -> None:
    """Sums over three rows, in 16 bits, so that compilers make good vector code of it."""
    for i in range(len(here)):
        sums[i] = np.uint16(np.uint16(np.uint16(above[i]) + np.uint16(here[i])) + np.uint16(below[i]))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _mean(sums: Sums, color: Bytes) -> None:
    """A fifteenth, rounded, of the sums over five columns, which begin two columns before those of `color`."""
    n = len(color)
    a, b, c, d, e = sums[:n], sums[3 : n + 3], sums[6 : n + 6], sums[9 : n + 9], sums[12 : n + 12]
    for i in range(n):
        four = np.uint16(np.uint16(a[i] + b[i]) + np.uint16(c[i] + d[i]))
        fifteen = np.uint16(np.uint16(four + e[i]) + np.uint16(7))
        # Division by 15, exact for sums of 15 bytes.
        color[i] = np.uint32(np.uint32(fifteen) * np.uint32(4370)) >> np.uint32(16)
