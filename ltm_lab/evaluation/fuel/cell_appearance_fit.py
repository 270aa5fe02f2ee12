"""Fits the cell appearance model of a network (`fuel.cell_appearance_model`) to frames of sites with known truth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import log_softmax

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float64Array, Int64Array, UInt8Array
from ltm_core.fuel.cell_appearance_model import SEEN, CellAppearanceModel, at_incidence, what_is_seen
from ltm_core.fuel.life_form import FORMS, form_counts
from ltm_core.fuel.votes import CellVotes

INCIDENCE = (0.05, 0.5)
"""Cosines: from 3 degrees over the ground to 30."""
LEAST_PIXELS_LEARNT = 3
"""Least pixels that a cell must have in a frame to be learnt from."""
LEAST_CELLS = 150
"""Of a form, over all frames, before it counts as known."""
_RIDGE = 3.0
"""Penalty of squared weights, which keeps those that little is known of near zero."""


@dataclass(frozen=True, eq=False)
class SeenCells:
    """Cells of known form as frames saw them: (N,) rows, columns and index of the true form, (N, SEEN) what is seen,
    (N,) cosine of incidence.
    """

    rows: Int64Array
    cols: Int64Array
    true: Int64Array
    seen: Float64Array
    cosine: Float64Array


def seen_cells(
    frames: Iterable[CellVotes], truth: UInt8Array, forms: Int64Array, least: int = LEAST_PIXELS_LEARNT
) -> SeenCells:
    """The cells of one site's frames that have `least` pixels. `truth`: (H, W) life forms on the votes' grid. `forms`:
    of the labels (`life_form.label_forms`). Raises ImageError for votes without a visibility.
    """
    parts: list[tuple[Int64Array, Int64Array, Int64Array, Float64Array, Float64Array]] = []
    for votes in frames:
        if votes.visibility is None:
            raise ImageError(f"votes of {votes.source} do not tell how each cell is seen")
        counts = form_counts(votes.counts, forms)
        pixels = counts.sum(axis=1)
        votes, counts, pixels = votes.only(pixels > 0), counts[pixels > 0], pixels[pixels > 0]
        assert votes.visibility is not None  # nosec B101 # tells the type checker what holds
        rows, cols = votes.rows.astype(np.int64), votes.cols.astype(np.int64)
        seen = what_is_seen(rows, cols, counts / pixels[:, None], votes.visibility.bearing, votes.confidence)
        true = truth[rows, cols].astype(np.int64) - 1
        good = (pixels >= least) & (true >= 0) & (true < FORMS)
        cosine = votes.visibility.cos_incidence.astype(np.float64)
        parts.append((rows[good], cols[good], true[good], seen[good], cosine[good]))
    if not parts:
        raise ImageError("no frame to learn the looks of cells from")
    return SeenCells(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def fit_cell_appearance(sites: Sequence[SeenCells]) -> CellAppearanceModel:
    """Logistic regression over the cells of all sites; each form weighs the same.

    Raises ImageError where fewer than two forms have cells enough.
    """
    cells = np.sum([np.bincount(site.true, minlength=FORMS) for site in sites], axis=0)
    known = np.flatnonzero(cells >= LEAST_CELLS)
    if len(known) < 2:
        raise ImageError(f"fewer than two life forms have {LEAST_CELLS} cells to learn from: {cells.tolist()}")
    knots = np.array(INCIDENCE)
    inputs = np.concatenate([at_incidence(site.seen, site.cosine, knots) for site in sites])
    true = np.concatenate([site.true for site in sites])
    used = np.isin(true, known)
    inputs, true = inputs[used], true[used]
    is_form = (true[:, None] == known).astype(np.float64)
    weight = len(true) / len(known) / cells[true]
    shape = inputs.shape[1], len(known)

    def loss(flat: Float64Array) -> tuple[float, Float64Array]:
        weights = flat.reshape(shape)
        log_p = log_softmax(inputs @ weights, axis=1)
        value = -float(weight @ (is_form * log_p).sum(axis=1)) + _RIDGE / 2 * float((weights**2).sum())
        slope = inputs.T @ (weight[:, None] * (np.exp(log_p) - is_form)) + _RIDGE * weights
        return value, slope.ravel()

    found = minimize(loss, np.zeros(shape).ravel(), jac=True, method="L-BFGS-B", options={"maxiter": 300})
    weights = np.full((FORMS, len(knots), SEEN), np.nan)
    weights[known] = found.x.reshape(shape).T.reshape(len(known), len(knots), SEEN)
    return CellAppearanceModel(knots, weights)
