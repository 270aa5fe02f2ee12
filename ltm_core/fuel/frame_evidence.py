"""What the votes of one frame say of the life forms of the cells that it sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_softmax

from ltm_core.errors import ImageError
from ltm_core.fuel.evidence_kernel import spread, with_neighbours
from ltm_core.fuel.label_errors import LabelErrors
from ltm_core.fuel.life_form import FORMS
from ltm_core.fuel.rules import FusionRules
from ltm_core.fuel.votes import CellVotes

_SUPPORTS = 0.5
"""Least evidence by which a frame is one of those that show a life form in a cell."""


@dataclass(frozen=True, eq=False)
class FrameEvidence:
    """`rows`, `cols`: (N,) int64 cells of the fuel grid. `amounts`: (N, FORMS) evidence for each life form, at most
    the frame cap a cell. `supported`: (N,) int64 index of the form that the frame shows there, -1 where it is not sure.
    `bearing`: (N,) radians clockwise from grid north in which the frame looks at the cell; None: not known.
    """

    rows: NDArray[np.int64]
    cols: NDArray[np.int64]
    amounts: NDArray[np.float64]
    supported: NDArray[np.int64]
    bearing: NDArray[np.float64] | None

    def __len__(self) -> int:
        return len(self.rows)


def frame_evidence(
    votes: CellVotes,
    forms: NDArray[np.int64],
    errors: LabelErrors,
    rules: FusionRules,
    stands: NDArray[np.uint8] | None = None,
) -> FrameEvidence:
    """Evidence w n p(l) of each cell.

    p is the probability of each life form given the cell's labels and what the network calls each form, averaged over
    the cells that may really have been seen instead. n counts pixels up to the cap. w is less than 1 for labels of
    low confidence, pixels that are coarser than the cell, and cells whose surroundings the frame does not show.

    Args:
        forms: (K,) index of each label's life form, -1 for none (`life_form.label_forms`).
        stands: (H, W) a number for each kind of stand that the prior map knows, 0 unknown; None: nothing is known.

    Raises ImageError for votes over other classes.
    """
    if votes.counts.shape[1] != len(forms):
        raise ImageError(f"votes of {votes.source} count {votes.counts.shape[1]} classes, this map {len(forms)}")
    counts = np.zeros((len(votes), FORMS))
    for label, form in enumerate(forms):
        if form >= 0:
            counts[:, form] += votes.counts[:, label]
    pixels = counts.sum(axis=1)
    useful = pixels > 0
    if votes.sighting is not None:
        useful &= np.maximum(votes.sighting.sigma_along, votes.sighting.sigma_across) <= rules.max_sigma
    votes, counts, pixels = votes.only(useful), counts[useful], pixels[useful]
    rows, cols = votes.rows.astype(np.int64), votes.cols.astype(np.int64)
    stand = np.zeros(len(rows), np.uint8) if stands is None else stands[rows, cols]
    probability = _probability(rows, cols, counts / pixels[:, None], pixels, stand, errors, rules)
    amount = np.minimum(pixels, rules.frame_cap)
    bearing = None
    if votes.confidence is not None:
        amount *= np.minimum(votes.confidence / rules.sure, 1.0)
    if votes.sighting is not None:
        cell = votes.geometry.resolution
        amount *= cell / np.hypot(cell, votes.sighting.footprint)
        cosine = np.maximum(votes.sighting.cos_incidence.astype(np.float64), 0.02)
        parallax = rules.relief * np.sqrt(1 - np.minimum(cosine, 1.0) ** 2) / cosine
        bearing = votes.sighting.bearing.astype(np.float64)
        probability, coverage = spread(
            rows,
            cols,
            probability,
            amount,
            np.minimum(np.hypot(votes.sighting.sigma_along, parallax), rules.max_sigma) / cell,
            votes.sighting.sigma_across.astype(np.float64) / cell,
            bearing,
        )
        amount *= coverage
    # Shafer's discount: labels that two forms explain as well say nothing of either.
    first, second = (np.partition(probability, -k, axis=1)[:, -k] for k in (1, 2))
    amounts = (amount * (first - second))[:, None] * probability
    shown = amounts.argmax(axis=1)
    sure = amounts.max(axis=1, initial=0.0) >= np.maximum(_SUPPORTS, 0.5 * amount)
    return FrameEvidence(rows, cols, amounts, np.where(sure, shown, -1), bearing)


def _probability(
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    shares: NDArray[np.float64],
    pixels: NDArray[np.float64],
    stand: NDArray[np.uint8],
    errors: LabelErrors,
    rules: FusionRules,
) -> NDArray[np.float64]:
    """(N, FORMS) of each life form given the shares of labels: a softmax of the labels' log likelihoods.

    Plants grow in stands larger than a cell, so that what the cells about it look like speaks for a cell too.
    """
    table = errors.log_likelihood()
    known = np.isfinite(table).all(axis=1)
    correlation = errors.correlation
    independent = pixels / (1 + (pixels - 1) * correlation.cell)
    own = independent[:, None] * (shares @ table[known].T)
    pooled, cells = with_neighbours(rows, cols, own, stand, rules.context, rules.context_cells)
    pooled /= (1 + (cells - 1) * correlation.between_cells)[:, None]
    likelihood = np.full((len(shares), FORMS), -np.inf)
    likelihood[:, known] = pooled
    return np.asarray(np.exp(log_softmax(likelihood, axis=1)), np.float64)
