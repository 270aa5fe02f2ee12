"""Compute the evidence for the life form of each cell from the votes of one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # loads scipy.special when it is first used

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float64Array, Int64Array, UInt8Array
from ltm_core.fuel.cell_appearance_model import what_is_seen
from ltm_core.fuel.evidence_kernel import spread, with_neighbours
from ltm_core.fuel.label_errors import FLOOR, LabelErrors
from ltm_core.fuel.life_form import form_counts
from ltm_core.fuel.rules import FusionRules
from ltm_core.fuel.votes import CellVotes

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
    votes: CellVotes, forms: Int64Array, errors: LabelErrors, rules: FusionRules, stands: UInt8Array | None = None
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
    # The appearance model already uses the labels' confidence.
    by_look = errors.appearance is not None and votes.visibility is not None
    if votes.confidence is not None and not by_look:
        amount *= np.minimum(votes.confidence / rules.sure, 1.0)
    if votes.visibility is not None:
        cell = votes.geometry.resolution
        amount *= cell / np.hypot(cell, votes.visibility.footprint)
        bearing = votes.visibility.bearing.astype(np.float64)
        probability, coverage = spread(
            rows,
            cols,
            probability,
            amount,
            votes.visibility.sigma_along.astype(np.float64) / cell,
            votes.visibility.sigma_across.astype(np.float64) / cell,
            bearing,
        )
        amount *= coverage
    amounts = amount[:, None] * probability
    clear = amounts.max(axis=1) >= np.maximum(_SUPPORTS, 0.5 * amount)
    return FrameEvidence(rows, cols, amounts, np.where(clear, amounts.argmax(axis=1), -1), bearing)


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
        look, seen = errors.appearance, votes.visibility
        by_look = shares[:, look.known].sum(axis=1) >= 0.5
        features = what_is_seen(rows, cols, shares, seen.bearing, votes.confidence)
        likelihood = look.log_likelihood(features, seen.cos_incidence.astype(np.float64))
        told = scipy.special.log_softmax(likelihood[by_look], axis=1)
        own[by_look] = np.maximum(told, np.log(FLOOR))
    known = np.isfinite(own).all(axis=0)
    # In one order of axes, however many cells: one kernel is compiled.
    of_known = np.ascontiguousarray(scipy.special.log_softmax(own[:, known], axis=1))
    pooled, cells = with_neighbours(rows, cols, of_known, stand, rules.context, rules.context_cells)
    divisors = 1 + (cells - 1) * correlation.between_cells
    probability = np.zeros(shares.shape)
    probability[:, known] = scipy.special.softmax(pooled / divisors[:, None], axis=1)
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
