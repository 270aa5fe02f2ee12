"""Compute the evidence for the life form of each cell from the votes of one frame."""

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
    """Return the evidence w n p(l) of each cell. Raises ImageError for votes over other classes.

    p is the probability of each life form given what the cell looks like, averaged over the cells that may really have
    been seen instead. n counts pixels up to the cap. w is less than 1 for pixels that are coarser than the cell, and
    cells whose surroundings the frame does not show. Without an appearance model, p is that of the label shares,
    flatter for labels of low confidence, and w is also less than 1 for these.

    `forms`: (K,) index of each label's life form, -1 for none (`life_form.label_forms`). `stands`: (H, W) a number for
    each kind of stand that the prior map knows, 0 unknown; None: nothing is known."""
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
        seen = votes.visibility
        sigmas = (sigma.astype(np.float64) / cell for sigma in (seen.sigma_along, seen.sigma_across))
        probability, coverage = spread(rows, cols, probability, amount, *sigmas, bearing)
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
    """Return (N, FORMS) of each life form given the shares of labels: a softmax of their log likelihoods. Plants grow
    in stands larger than a cell, so that the appearance of neighbouring cells is evidence for a cell too."""
    correlation = errors.correlation
    weight = pixels / (1 + (pixels - 1) * correlation.cell)
    if votes.confidence is not None:
        # Log odds that labels of this confidence are right, over those of sure ones.
        chance = np.clip(votes.confidence.astype(np.float64), 0.5, rules.sure)
        weight *= np.log(chance / (1 - chance)) / np.log(rules.sure / (1 - rules.sure))
    table = errors.log_likelihood()
    tested = np.isfinite(table).all(axis=1)
    own = np.full(shares.shape, -np.inf)
    own[:, tested] = weight[:, None] * (shares @ table[tested].T)
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
