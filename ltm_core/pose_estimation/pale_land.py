"""Far land, pale before the sky, above the edge of nearer land that the strongest gradient takes for the sky's.

Going down from clear sky, its upper edge is the first step of colour that stands out from what the sky does by itself,
and from there on all is alike until the nearer land begins. An edge that is merely blurred, or slanted, grows darker
all the way down.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit

from ltm_core.types import Float32Array, Float64Array, Int64Array, UInt8Array
from ltm_core.vision.cie_lab import cie_lab

_ABOVE, _SKY = 12.0 / 640, 20.0 / 640
"""Widths of the image above the nearer land's edge within which pale land is sought, and above those where the sky
tells how uneven it is."""
_LEAST_STEP, _STEPS = 3.0, 6.7
"""By which it must stand out, in units of CIE Lab, and in what the sky changes by."""
_PALE, _ALIKE = 25.0, (2.0, 2.0)
"""What differs from the sky by more is no pale land; nor what does by more than so many times the step and so much."""
_ACROSS = 5
"""Pixels across which colours are averaged,"""
_THICK = 2.0
"""and by how many of an image of 640 across pale land must be higher than what a slanted edge is blurred to by that."""


def pale_edges(photo: UInt8Array, u: Int64Array, v: Float64Array) -> Float64Array:
    """Rows (K,) where pale land begins in columns `u` of a photo (H, W, 3), above nearer land that begins at rows `v`;
    `v` where there is none, or three of five neighbouring columns do not agree on it. Columns must rise.
    """
    if len(u) < 2:
        return v
    unit = photo.shape[1] / 640
    above, sky, size = round(_ABOVE * photo.shape[1]), round(_SKY * photo.shape[1]), max(2, round(2 * unit))
    ends = np.floor(v - unit).astype(np.int64)
    seen = photo[: max(int(ends.max()) + size, 1)]  # what lies lower tells nothing
    found = _first_step(np.asarray(cv2.blur(cie_lab(seen), (_ACROSS, 1)), np.float32), u, ends, above, sky, size)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(found, 2, constant_values=np.nan), 5)
    agreed = np.isfinite(windows).sum(axis=1) >= 3
    middle = np.full(len(u), np.nan)
    middle[agreed] = np.nanmedian(windows[agreed], axis=1)
    thick = v - found > _THICK * unit + _ACROSS * np.abs(np.gradient(v, u))
    return np.where((np.abs(found - middle) < 2 * unit) & thick, found, v)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def _apart(lab: Float32Array, column: int, a: int, b: int, size: int) -> float:
    """How far the mean colour of `size` rows from `a` on is from that of those from `b` on."""
    total = 0.0
    for i in range(3):
        away = 0.0
        for row in range(size):
            away += lab[a + row, column, i] - lab[b + row, column, i]
        total += (away / size) ** 2
    return float(np.sqrt(total))


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _is_pale(lab: Float32Array, column: int, row: int, end: int, above: int, size: int, step: float) -> bool:
    """Whether all from `row` down to `end` stands out from what is `above` it by about a step, and is no cloud."""
    if lab[row : row + size, column, 0].mean() > lab[above + 1 : above + 1 + size, column, 0].mean():
        return False  # air makes far land as light as the sky and no lighter
    lowest, highest = np.inf, 0.0
    sky = np.array([lab[above : above + size, column, i].mean() for i in range(3)])
    for below in range(row, end + 1):
        total = 0.0
        for i in range(3):
            total += (lab[below, column, i] - sky[i]) ** 2
        lowest, highest = min(lowest, np.sqrt(total)), max(highest, np.sqrt(total))
    return bool(lowest > 0.5 * step and highest < min(_PALE, _ALIKE[0] * step + _ALIKE[1]))


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _first_step(lab: Float32Array, u: Int64Array, ends: Int64Array, above: int, sky: int, size: int) -> Float64Array:
    """Of columns (K,) the row from which on all, down to `ends`, stands out from the sky alike; NaN without."""
    found = np.full(len(u), np.nan)
    skip = size // 2  # rows that an edge is blurred over
    steps = np.zeros(above + sky + 1)
    for k in range(len(u)):
        column, end = u[k], ends[k]
        top = end - above - sky
        if top < size + skip + 2:
            continue
        for n in range(above + sky):
            steps[n] = _apart(lab, column, top + n, top + n - size - skip, size)
        least = max(_LEAST_STEP, _STEPS * np.median(steps[: sky - size]))
        for n in range(sky, above + sky):
            if steps[n] > least and steps[n] >= steps[n + 1] and steps[n] >= steps[n - 1]:
                row = top + n
                cleared = _apart(lab, column, row, top, size) < 0.5 * steps[n]  # sky below a cloud
                if not cleared and _is_pale(lab, column, row, end, row - size - skip - 1, size, steps[n]):
                    found[k] = row - 0.25 - 0.5 * skip
                break
    return found
