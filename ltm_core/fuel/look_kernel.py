"""Compiled loops over the cells of one frame: what life form each looks like, and which one it shows.

A frame has some hundred cells of seven forms: of the same as NumPy expressions, most of the time goes by between them.
`cell_appearance_model` has the looks as such expressions, which teach the model.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from ltm_core.fuel.life_form import FORMS
from ltm_core.types import Float64Array, Int64Array


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def tell_by_look(
    rows: Any,
    cols: Any,
    shares: Any,
    sure: Any,
    bearing: Any,
    cosine: Any,
    incidence: Any,
    weights: Any,
    known: Any,
    least: float,
    own: Any,
) -> None:
    """Put the log probability of each form by the cell's look into `own` (N, F), `least` or more, for cells that are
    mostly called what the looks were learnt of; the others stay.

    As `CellAppearanceModel.log_likelihood(what_is_seen(...))`, normalised. `shares` (N, F): of the labels; `sure` (N,):
    their confidence beyond the usual. `weights` (K, SEEN, F): of what is looked at, at each of K incidences; `known`
    (F,): forms that the looks were learnt of.
    """
    n = len(rows)
    if n == 0:
        return
    top, left = rows.min() - 1, cols.min() - 1
    index = np.full((rows.max() - top + 2, cols.max() - left + 2), -1, np.int32)
    for i in range(n):
        index[rows[i] - top, cols[i] - left] = i
    told = np.empty(FORMS)
    for i in range(n):
        usual = 0.0
        for f in range(FORMS):
            if known[f]:
                usual += shares[i, f]
        if usual < 0.5:
            continue
        r, c = rows[i] - top, cols[i] - left
        north, east = int(np.rint(np.cos(bearing[i]))), int(np.rint(np.sin(bearing[i])))
        before, behind = index[r + north, c - east], index[r - north, c + east]
        before, behind = (i if before < 0 else before), (i if behind < 0 else behind)
        # Between two incidences the weights are linear, beyond the last ones constant.
        knot = 0
        while knot < incidence.size - 2 and cosine[i] >= incidence[knot + 1]:
            knot += 1
        across = (cosine[i] - incidence[knot]) / (incidence[knot + 1] - incidence[knot])
        across = min(max(across, 0.0), 1.0)
        told[:] = 0.0
        for side in range(2):
            part = across if side else 1.0 - across
            if part == 0.0:
                continue
            of = weights[knot + side]
            for f in range(FORMS):
                told[f] += part * of[0, f]
            for g in range(FORMS):
                seen = part * shares[i, g]
                if seen != 0.0:
                    unsure = seen * sure[i]
                    for f in range(FORMS):
                        told[f] += seen * of[1 + g, f] + unsure * of[1 + FORMS + g, f]
                seen = part * shares[before, g]
                if seen != 0.0:
                    for f in range(FORMS):
                        told[f] += seen * of[1 + 2 * FORMS + g, f]
                seen = part * shares[behind, g]
                if seen != 0.0:
                    for f in range(FORMS):
                        told[f] += seen * of[1 + 3 * FORMS + g, f]
        most, whole = -np.inf, 0.0
        for f in range(FORMS):
            if known[f]:
                most = max(most, told[f])
        for f in range(FORMS):
            if known[f]:
                whole += np.exp(told[f] - most)
        for f in range(FORMS):
            own[i, f] = max(told[f] - most - np.log(whole), least) if known[f] else least


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def log_normalised(values: Any) -> Float64Array:
    """(N, F) logarithms, shifted so that their exponentials sum to 1 in each row."""
    n, width = values.shape
    out = np.empty((n, width))
    for i in range(n):
        most, whole = -np.inf, 0.0
        for f in range(width):
            most = max(most, values[i, f])
        for f in range(width):
            whole += np.exp(values[i, f] - most)
        shift = most + np.log(whole)
        for f in range(width):
            out[i, f] = values[i, f] - shift
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def normalised(logs: Any, divisors: Any) -> Float64Array:
    """(N, F) the exponentials of logarithms over `divisors` (N,), as shares of their sum in each row."""
    n, width = logs.shape
    out = np.empty((n, width))
    for i in range(n):
        most, whole = -np.inf, 0.0
        for f in range(width):
            out[i, f] = logs[i, f] / divisors[i]
            most = max(most, out[i, f])
        for f in range(width):
            out[i, f] = np.exp(out[i, f] - most)
            whole += out[i, f]
        for f in range(width):
            out[i, f] /= whole
    return out


@numba.njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def shown_forms(amounts: Any, most: Any, least: float) -> Int64Array:
    """(N,) index of the form that has most of `amounts` (N, F), -1 where that is less than `least` or than half of the
    cell's `most` (N,)."""
    n, width = amounts.shape
    out = np.empty(n, np.int64)
    for i in range(n):
        shown = 0
        for f in range(1, width):
            if amounts[i, f] > amounts[i, shown]:
                shown = f
        out[i] = shown if amounts[i, shown] >= max(least, 0.5 * most[i]) else -1
    return out
