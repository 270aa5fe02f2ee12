"""Spread one frame's votes over neighbouring cells, add them as evidence and pool observations, in compiled loops."""

from typing import Any

import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Float64Array

_REACH = 2.5
"""Number of sigmas to which the displacement of a cell is followed."""


@helper()
def index_of(rows: Any, cols: Any) -> Any:
    """Return the row and column where a window begins that holds the cells (N,) and one cell around them, and (H, W)
    int32 which cell each place of it is, -1 for none."""
    top, left, bottom, right = rows[0], cols[0], rows[0], cols[0]
    for i in range(1, rows.size):
        top, bottom = min(top, rows[i]), max(bottom, rows[i])
        left, right = min(left, cols[i]), max(right, cols[i])
    top, left = top - 1, left - 1
    index = np.full((bottom - top + 2, right - left + 2), np.int32(-1))
    for i in range(rows.size):
        index[rows[i] - top, cols[i] - left] = i
    return top, left, index


@helper()
def _gaussian(weight: float, sigma: float) -> Any:
    """Return (2 R + 1, 2 R + 1): `weight` at the centre."""
    reach = int(2 * sigma + 0.5)
    kernel = np.empty((2 * reach + 1, 2 * reach + 1))
    for dr in range(-reach, reach + 1):
        for dc in range(-reach, reach + 1):
            kernel[dr + reach, dc + reach] = weight * np.exp(-0.5 * (dr * dr + dc * dc) / (sigma * sigma))
    return kernel


@kernel(nogil=True)
def with_neighbours(
    rows: Any, cols: Any, values: Any, stands: Any, weight: float, sigma: float
) -> tuple[Float64Array, Float64Array]:
    """Return `values` (N, F) of each cell plus those of the neighbouring cells of its stand (N,), weighted by `weight`
    times a Gaussian of `sigma` cells; and (N,) the sum of these weights, 1 for the cell itself. Stand 0 is unknown and
    may end anywhere: there the Gaussian covers one cell."""
    n, width = values.shape
    out, cells = values.copy(), np.ones(n)
    if n == 0 or weight == 0:
        return out, cells
    top, left, index = index_of(rows, cols)
    kernels = _gaussian(weight, min(sigma, 1.0)), _gaussian(weight, sigma)
    for i in range(n):
        row, col = rows[i] - top, cols[i] - left
        kernel = kernels[0] if stands[i] == 0 else kernels[1]
        reach = kernel.shape[0] // 2
        for r in range(max(row - reach, 0), min(row + reach + 1, index.shape[0])):
            for c in range(max(col - reach, 0), min(col + reach + 1, index.shape[1])):
                j = index[r, c]
                if j >= 0 and j != i and stands[j] == stands[i]:
                    share = kernel[r - row + reach, c - col + reach]
                    cells[i] += share
                    for f in range(width):
                        out[i, f] += share * values[j, f]
    return out, cells


@kernel(nogil=True)
def spread(
    rows: Any, cols: Any, shares: Any, weights: Any, sigma_along: Any, sigma_across: Any, bearing: Any
) -> tuple[Float64Array, Float64Array]:
    """Return shares (N, F) averaged over the possible places of each cell's pixels, and the part of these that the
    frame sees. The cell that is traced to (row, col) is another one with the probability that a Gaussian of
    `sigma_along` and `sigma_across` (N,), in cells, gives it; `bearing` (N,) radians clockwise from north is the
    direction of along. `weights` (N,): of the cells' shares in the average."""
    n, forms = shares.shape
    out = np.zeros((n, forms))
    coverage = np.ones(n)
    if n == 0:
        return out, coverage
    top, left, index = index_of(rows, cols)
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
        # The ellipse as square = xx dx^2 + 2 xy dx dy + yy dy^2: the part of each row that may lie in it.
        xx = (sine / a) ** 2 + (cosine / b) ** 2
        xy = sine * cosine * (1 / b**2 - 1 / a**2)
        yy = (cosine / a) ** 2 + (sine / b) ** 2
        for dy in range(-reach_y, reach_y + 1):
            r = rows[i] - top + dy
            half = np.sqrt(max((xy * dy) ** 2 - xx * (yy * dy * dy - _REACH * _REACH), 0.0)) / xx
            middle = -xy * dy / xx
            first = max(int(np.floor(middle - half)), -reach_x)
            for dx in range(first, min(int(np.ceil(middle + half)), reach_x) + 1):
                along = (dx * sine - dy * cosine) / a
                across = (dx * cosine + dy * sine) / b
                square = along * along + across * across
                if square > _REACH * _REACH:
                    continue
                share = np.exp(-0.5 * square)
                whole += share
                c = cols[i] - left + dx
                if r < 0 or r >= height or c < 0 or c >= width:
                    continue
                j = index[r, c]
                if j < 0:
                    continue
                seen += share
                weight = share * weights[j]
                total += weight
                for f in range(forms):
                    out[i, f] += weight * shares[j, f]
        # The mean over the cells that the frame sees.
        coverage[i] = seen / whole
        if total > 0:
            out[i] /= total
        else:
            out[i] = shares[i]
    return out, coverage


@helper()
def remember(row: Any, value: Any) -> None:
    """Keep `value` among the least distinct ones of `row`, which are sorted; 0 is an empty place."""
    for k in range(row.size):
        if row[k] == value:
            return
        if row[k] == 0:
            row[k] = value
            return
        if value < row[k]:
            value, row[k] = row[k], value


@helper()
def slot_of(epochs: Any, epoch: Any, shown: Any, best: Any, span: Any) -> int:
    """Return the index of an epoch among the newest ones of a view, which are kept newest first; 0 is an empty place. A
    new one pushes the oldest out; -1 for one that is older than all that are kept."""
    kept = epochs.size
    place = 0
    while place < kept and epochs[place] > epoch:
        place += 1
    if place == kept:
        return -1
    if epochs[place] != epoch:
        for k in range(kept - 1, place, -1):
            epochs[k], best[k], shown[k], span[k] = epochs[k - 1], best[k - 1], shown[k - 1], span[k - 1]
        epochs[place], best[place], shown[place], span[place] = epoch, 0, 0, 0
    return place


@kernel()
def accumulate(
    rows: Any, cols: Any, amounts: Any, supported: Any, views: Any, second: Any, epoch: Any, camera: Any, state: Any
) -> None:
    """Add `amounts` (N, F), whole numbers, to what the views (N,) show in an epoch; `supported` (N,): the form whose
    frames are kept count of, -1 for none. `state`: the arrays `evidence.EVIDENCE_FIELDS`. Each step is a sum of
    integers, a minimum, a maximum, or the choice of the newest or the least of a set: the state does not depend on the
    order of frames, to the last bit."""
    shown, best, span, epochs, first, last, camera_hashes, seen_by, last_seen, burned_at = state
    ceiling = np.uint64(np.iinfo(np.uint32).max)
    for i in range(rows.size):
        r, c = rows[i], cols[i]
        if second < burned_at[r, c]:
            continue  # it shows what has burned since
        last_seen[r, c] = max(last_seen[r, c], second)
        remember(seen_by[r, c], camera)
        f = supported[i]
        if f >= 0:
            first[r, c, f] = second if first[r, c, f] == 0 else min(first[r, c, f], second)
            last[r, c, f] = max(last[r, c, f], second)
            remember(camera_hashes[r, c, f], camera)
        v = views[i]
        e = slot_of(epochs[r, c, v], epoch, shown[r, c, v], best[r, c, v], span[r, c, v])
        if e < 0:
            continue  # the view has newer looks enough
        whole = np.uint64(0)
        for g in range(amounts.shape[1]):
            whole += np.uint64(amounts[i, g])
            shown[r, c, v, e, g] = np.uint32(min(np.uint64(shown[r, c, v, e, g]) + np.uint64(amounts[i, g]), ceiling))
        best[r, c, v, e] = max(best[r, c, v, e], whole)
        if span[r, c, v, e, 0] == 0 or second < span[r, c, v, e, 0]:
            span[r, c, v, e, 0] = second
        span[r, c, v, e, 1] = max(span[r, c, v, e, 1], second)


@kernel()
def pooled(
    shown: Any,
    best: Any,
    span: Any,
    now: float,
    decay_s: Any,
    look_s: float,
    between_frames: float,
    between_views: float,
    full: float,
    least: float,
) -> tuple[Float64Array, Float64Array]:
    """Return (N, F) effective evidence of the observations of all views together at a time, and (N, F) the joint log
    likelihood of each form, up to a constant: nested design effects.

    `shown` (N, V, E, F), `best` (N, V, E), `span` (N, V, E, 2): what each view shows in each epoch, the most that a
    frame adds to it, and its first and last second. `full`: that most of a frame that sees a cell perfectly. What a
    frame shows are probabilities under equal odds of all forms: as likelihoods those of views multiply, where as
    evidence they are averaged. `least`: of what is shown, the least share that any form is taken to have.

    Views that resemble each other count less than independent ones: evidence by its amount, likelihoods by how much
    likelier each view makes one form than all others. A grazing view that tells little takes nothing from another."""
    n, views, epochs, forms = shown.shape
    out, told = np.zeros((n, forms)), np.zeros((n, forms))
    share, lasting = np.empty(forms), np.empty(forms)
    for i in range(n):
        total, largest, clear, clearest = 0.0, 0.0, 0.0, 0.0
        for v in range(views):
            share[:], lasting[:] = 0.0, 0.0
            whole, kept, peak, looks, begin, end = 0.0, 0.0, 0.0, 0.0, np.inf, 0.0
            # One view: what it showed in all epochs, faded by age.
            for e in range(epochs):
                if best[i, v, e] == 0:
                    continue
                opened, closed = float(span[i, v, e, 0]), float(span[i, v, e, 1])
                age = max(now - closed, 0.0)
                here, faded = 0.0, 0.0
                for f in range(forms):
                    left = shown[i, v, e, f] * np.exp(-age / decay_s[f])
                    here += shown[i, v, e, f]
                    faded += left
                    share[f] += left
                for f in range(forms):
                    # Forms fade at paces of their own, yet what was likelier when it was seen is no likelier since.
                    lasting[f] += shown[i, v, e, f] * faded / here
                whole += here
                kept += faded
                peak = max(peak, float(best[i, v, e]))
                looks += 1 + (closed - opened) / look_s
                begin, end = min(begin, opened), max(end, closed)
            if whole == 0:
                continue
            # No more looks than frames of full worth, nor than the light has had time to change between.
            looks = max(min(looks, whole / peak, 1 + (end - begin) / look_s), 1.0)
            worth = peak * looks / (1 + (looks - 1) * between_frames)
            weight, first, second = worth / full * kept / whole, -np.inf, -np.inf
            for f in range(forms):
                out[i, f] += worth * share[f] / whole
                if kept > 0:
                    tells = weight * np.log((1 - forms * least) * lasting[f] / kept + least)
                    told[i, f] += tells
                    first, second = max(first, tells), max(second, min(first, tells))
            total += worth
            largest = max(largest, worth)
            if kept > 0:
                clear += first - second
                clearest = max(clearest, first - second)
        if total > 0:
            out[i] /= 1 + (total / largest - 1) * between_views
        if clearest > 0:
            told[i] /= 1 + (clear / clearest - 1) * between_views
    return out, told
