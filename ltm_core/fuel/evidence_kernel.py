"""Compiled loops over the cells of one frame: spreading over where they may lie, and counting them in."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

_REACH = 2.5
"""Sigmas to which the displacement of a cell is followed."""


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _index_of(rows: Any, cols: Any) -> Any:
    """(H, W) int32 over the bounding box of the cells and one cell about it: which cell stands there, -1 for none."""
    top, left = rows.min() - 1, cols.min() - 1
    index = np.full((rows.max() - top + 2, cols.max() - left + 2), -1, np.int32)
    for i in range(rows.size):
        index[rows[i] - top, cols[i] - left] = i
    return index


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def with_neighbours(rows: Any, cols: Any, values: Any, weight: float) -> Any:
    """`values` (N, F) of each cell plus `weight` times those of the up to eight cells about it."""
    n, width = values.shape
    out = values.copy()
    if n == 0 or weight == 0:
        return out
    index = _index_of(rows, cols)
    top, left = rows.min() - 1, cols.min() - 1
    for i in range(n):
        for r in range(rows[i] - top - 1, rows[i] - top + 2):
            for c in range(cols[i] - left - 1, cols[i] - left + 2):
                j = index[r, c]
                if j >= 0 and j != i:
                    for f in range(width):
                        out[i, f] += weight * values[j, f]
    return out


@numba.njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def spread(
    rows: Any,
    cols: Any,
    shares: Any,
    weights: Any,
    sigma_along: Any,
    sigma_across: Any,
    bearing: Any,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shares (N, F) averaged over where each cell's pixels may really lie, and the part of that which the frame sees.

    The cell that is traced to (row, col) is another one with the probability that a Gaussian of `sigma_along` and
    `sigma_across` (N,), in cells, gives it; `bearing` (N,) radians clockwise from north is the direction of along.
    `weights` (N,): of the cells' shares in the average.
    """
    n, forms = shares.shape
    out = np.zeros((n, forms))
    coverage = np.ones(n)
    if n == 0:
        return out, coverage
    index = _index_of(rows, cols)
    top, left = rows.min() - 1, cols.min() - 1
    height, width = index.shape
    for i in range(n):
        if max(sigma_along[i], sigma_across[i]) < 0.25:
            out[i] = shares[i]
            continue
        # A cell's own extent blurs where in it a pixel lies: a uniform distribution has a variance of 1/12.
        a, b = np.sqrt(sigma_along[i] ** 2 + 1 / 12), np.sqrt(sigma_across[i] ** 2 + 1 / 12)
        sine, cosine = np.sin(bearing[i]), np.cos(bearing[i])
        reach_x = int(_REACH * np.hypot(a * sine, b * cosine) + 0.5)
        reach_y = int(_REACH * np.hypot(a * cosine, b * sine) + 0.5)
        whole, seen, total = 0.0, 0.0, 0.0
        for dy in range(-reach_y, reach_y + 1):
            r = rows[i] - top + dy
            for dx in range(-reach_x, reach_x + 1):
                along = (dx * sine - dy * cosine) / a
                across = (dx * cosine + dy * sine) / b
                square = along * along + across * across
                if square > _REACH * _REACH:
                    continue
                share = np.exp(-0.5 * square)
                whole += share
                c = cols[i] - left + dx
                if r < 0 or r >= height or c < 0 or c >= width or index[r, c] < 0:
                    continue
                j = index[r, c]
                seen += share
                total += share * weights[j]
                for f in range(forms):
                    out[i, f] += share * weights[j] * shares[j, f]
        coverage[i] = seen / whole
        if total > 0:
            for f in range(forms):
                out[i, f] /= total
        else:
            out[i] = shares[i]
    return out, coverage


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def _remember(row: Any, value: Any) -> None:
    """Keep `value` among the least distinct ones of `row`, which are sorted; 0 is an empty place."""
    for k in range(row.size):
        if row[k] == value:
            return
        if row[k] == 0:
            row[k] = value
            return
        if value < row[k]:
            value, row[k] = row[k], value


@numba.njit(cache=True)  # type: ignore[untyped-decorator]
def accumulate(
    rows: Any,
    cols: Any,
    amounts: Any,
    supported: Any,
    second: Any,
    camera: Any,
    growth: Any,
    evidence: Any,
    first: Any,
    last: Any,
    witnesses: Any,
    seen_by: Any,
    last_seen: Any,
    burned_at: Any,
) -> None:
    """Add `amounts` (N, F), grown to the epoch's value by `growth` (F,); `supported` (N,): the form whose frames are
    kept count of, -1 for none. Each step is a sum, a minimum or a maximum, so that the order of frames does not matter.
    """
    for i in range(rows.size):
        r, c = rows[i], cols[i]
        if second < burned_at[r, c]:
            continue  # it shows what has burned since
        for f in range(growth.size):
            evidence[r, c, f] += amounts[i, f] * growth[f]
        last_seen[r, c] = max(last_seen[r, c], second)
        _remember(seen_by[r, c], camera)
        f = supported[i]
        if f >= 0:
            first[r, c, f] = second if first[r, c, f] == 0 else min(first[r, c, f], second)
            last[r, c, f] = max(last[r, c, f], second)
            _remember(witnesses[r, c, f], camera)
