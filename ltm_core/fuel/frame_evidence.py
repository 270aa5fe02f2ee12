"""Compute the evidence for the life form of each cell from the votes of one frame, in compiled loops.

A frame has some hundred cells, for which NumPy expressions as in `cell_appearance_model` are too slow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.kernels import kernel
from ltm_core.base.types import Float64Array, Int64Array, UInt8Array
from ltm_core.fuel.cell_appearance_model import USUAL
from ltm_core.fuel.evidence_kernel import index_of, spread, with_neighbours
from ltm_core.fuel.label_errors import FLOOR, LabelErrors
from ltm_core.fuel.life_form import FORMS, form_counts
from ltm_core.fuel.rules import FusionRules
from ltm_core.fuel.votes import CellVotes


@kernel(nogil=True)
def form_by_appearance(
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
    """Write the log probability of each form by the cell's appearance into `own` (N, F), at least `least`, for cells
    whose labels are mostly of forms in the appearance model; other cells stay.

    As `CellAppearanceModel.log_likelihood(what_is_seen(...))`, normalised. `shares` (N, F): of the labels; `sure` (N,):
    their confidence beyond the usual. `weights` (K, SEEN, F): of the model at each of K incidences; `known` (F,):
    forms in the model."""
    n = len(rows)
    if n == 0:
        return
    top, left, index = index_of(rows, cols)  # to find the neighbours before and behind each
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
        # The sum of the weights of what is seen: the cell itself, its confidence, and its neighbours.
        for f in range(FORMS):
            told[f] = 0.0
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
        # Normalised over the known forms.
        most, whole = -np.inf, 0.0
        for f in range(FORMS):
            if known[f]:
                most = max(most, told[f])
        for f in range(FORMS):
            if known[f]:
                whole += np.exp(told[f] - most)
        for f in range(FORMS):
            own[i, f] = max(told[f] - most - np.log(whole), least) if known[f] else least


@kernel(nogil=True)
def log_normalised(values: Any) -> Float64Array:
    """Return (N, F) logarithms, shifted so that their exponentials sum to 1 in each row."""
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


@kernel(nogil=True)
def normalised(logs: Any, divisors: Any) -> Float64Array:
    """Return (N, F) exponentials of the logarithms over `divisors` (N,), as shares of their sum in each row."""
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


@kernel(nogil=True)
def shown_forms(amounts: Any, most: Any, least: float) -> Int64Array:
    """Return (N,) index of the form that has most of `amounts` (N, F), -1 if that is less than `least` or than half of
    the cell's `most` (N,)."""
    n, width = amounts.shape
    out = np.empty(n, np.int64)
    for i in range(n):
        shown = 0
        for f in range(1, width):
            if amounts[i, f] > amounts[i, shown]:
                shown = f
        out[i] = shown if amounts[i, shown] >= max(least, 0.5 * most[i]) else -1
    return out


_SUPPORTS = 0.5
"""Minimum evidence for a frame to count as showing a life form in a cell."""


@dataclass(frozen=True, eq=False)
class FrameEvidence:
    """Evidence of one frame. `rows`, `cols`: (N,) int64 cells of the fuel grid. `amounts`: (N, FORMS) evidence for each
    life form, at most the frame cap per cell. `supported`: (N,) int64 index of the form that the frame shows there, -1
    if uncertain. `bearing`: (N,) radians clockwise from grid north from the camera to the cell; None: unknown."""

    rows: Int64Array
    cols: Int64Array
    amounts: Float64Array
    supported: Int64Array
    bearing: Float64Array | None

    def __len__(self) -> int:
        return len(self.rows)


def frame_evidence(
    votes: CellVotes,
    forms: Int64Array,
    errors: LabelErrors,
    rules: FusionRules,
    stands: UInt8Array | None = None,
) -> FrameEvidence:
    """Return the evidence w n p(l) of each cell.

    p is the probability of each life form given what the cell looks like, averaged over the cells that may really have
    been seen instead. n counts pixels up to the cap. w is less than 1 for pixels that are coarser than the cell, and
    cells whose surroundings the frame does not show. Of a network of whose cells' looks nothing is known, p is that of
    the labels' shares given what the network calls each form, flatter for labels of low confidence, and w is also less
    than 1 for these.

    Args:
        forms: (K,) index of each label's life form, -1 for none (`life_form.label_forms`).
        stands: (H, W) a number for each kind of stand that the prior map knows, 0 unknown; None: nothing is known.

    Raises ImageError for votes over other classes."""
    if votes.counts.shape[1] != len(forms):
        raise ImageError(f"votes of {votes.source} count {votes.counts.shape[1]} classes, this map {len(forms)}")
    counts = form_counts(votes.counts, forms)
    pixels = counts @ np.ones(counts.shape[1])  # whole numbers: exact, and quicker than a sum over so short an axis
    useful = pixels > 0
    if votes.visibility is not None:
        useful &= np.maximum(votes.visibility.sigma_along, votes.visibility.sigma_across) <= rules.max_sigma
    if not useful.all():
        votes, counts, pixels = votes.only(useful), counts[useful], pixels[useful]
    rows, cols = votes.rows.astype(np.int64), votes.cols.astype(np.int64)
    stand = np.zeros(len(rows), np.uint8) if stands is None else stands[rows, cols]
    probability = _probability(votes, rows, cols, counts / pixels[:, None], pixels, stand, errors, rules)
    amount = np.minimum(pixels, rules.frame_cap)
    bearing = None
    # The appearance model already uses the labels' confidence and the occlusion by plants.
    by_look = errors.appearance is not None and votes.visibility is not None
    if votes.confidence is not None and not by_look:
        amount *= np.minimum(votes.confidence / rules.sure, 1.0)
    if votes.visibility is not None:
        cell = votes.geometry.resolution
        amount *= cell / np.hypot(cell, votes.visibility.footprint)
        cosine = np.maximum(votes.visibility.cos_incidence.astype(np.float64), 0.02)
        relief = 0.0 if by_look else rules.relief
        parallax = relief * np.sqrt(1 - np.minimum(cosine, 1.0) ** 2) / cosine
        bearing = votes.visibility.bearing.astype(np.float64)
        probability, coverage = spread(
            rows,
            cols,
            probability,
            amount,
            np.minimum(np.hypot(votes.visibility.sigma_along, parallax), rules.max_sigma) / cell,
            votes.visibility.sigma_across.astype(np.float64) / cell,
            bearing,
        )
        amount *= coverage
    amounts = amount[:, None] * probability
    return FrameEvidence(rows, cols, amounts, shown_forms(amounts, amount, _SUPPORTS), bearing)


def _probability(
    votes: CellVotes,
    rows: Int64Array,
    cols: Int64Array,
    shares: Float64Array,
    pixels: Float64Array,
    stand: UInt8Array,
    errors: LabelErrors,
    rules: FusionRules,
) -> Float64Array:
    """Return (N, FORMS) of each life form given the shares of labels: a softmax of their log likelihoods.

    Plants grow in stands larger than a cell, so that the appearance of neighbouring cells is evidence for a cell too.
    """
    correlation = errors.correlation
    weight = pixels / (1 + (pixels - 1) * correlation.cell)
    if votes.confidence is not None:
        weight *= _odds_weight(votes.confidence.astype(np.float64), rules.sure)
    own = _log_shares(shares, errors, weight)
    if errors.appearance is not None and votes.visibility is not None:
        # Of cells that are mostly called what the looks were not learnt of, such as water, the labels are all there is.
        look = errors.appearance
        form_by_appearance(
            rows,
            cols,
            shares,
            np.zeros(len(rows)) if votes.confidence is None else (votes.confidence - USUAL).astype(np.float64),
            votes.visibility.bearing,
            votes.visibility.cos_incidence.astype(np.float64),
            look.incidence,
            look.by_incidence,
            look.known,
            np.log(FLOOR),
            own,
        )
    known = np.isfinite(own).all(axis=0)
    of_known = np.ascontiguousarray(own[:, known])  # in one order of axes, however many cells: one kernel is compiled
    pooled, cells = with_neighbours(rows, cols, log_normalised(of_known), stand, rules.context, rules.context_cells)
    probability = np.zeros(shares.shape)
    probability[:, known] = normalised(pooled, 1 + (cells - 1) * correlation.between_cells)
    return probability


def _log_shares(shares: Float64Array, errors: LabelErrors, weight: Float64Array) -> Float64Array:
    """Return (N, FORMS) log likelihood of a cell's label shares (N, FORMS), averaged over (N,) pixels."""
    table = errors.log_likelihood()
    known = np.isfinite(table).all(axis=1)
    result = np.full(shares.shape, -np.inf)
    result[:, known] = weight[:, None] * (shares @ table[known].T)
    return result


def _odds_weight(confidence: Float64Array, sure: float) -> Float64Array:
    """Return (N,) in [0, 1]: log odds that labels of this confidence are right, over those of sure ones."""
    chance = np.clip(confidence, 0.5, sure)
    return np.asarray(np.log(chance / (1 - chance)) / np.log(sure / (1 - sure)))
