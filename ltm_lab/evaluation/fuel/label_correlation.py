"""Estimates how strongly a network's label errors correlate within a fuel cell, from votes of known truth.

A look at a cell is a pixel's label, expected with the shares that are known of the network; or the appearance of the
whole cell, where that is known (`ltm_core.fuel.label_measurement`)."""

from collections.abc import Sequence

import numpy as np

from ltm_core.base.types import Int64Array, UInt8Array
from ltm_core.fuel.label_errors import LabelCorrelation, LabelErrors
from ltm_core.fuel.label_measurement import (
    LEAST_PIXELS_MEASURED,
    FrameErrors,
    correlation_of_pairs,
    look_correlation,
    looks,
    pair_sums,
)
from ltm_core.fuel.life_form import FORMS, form_counts
from ltm_core.fuel.votes import CellVotes


def label_correlation(
    frames: Sequence[CellVotes],
    truth: UInt8Array,
    forms: Int64Array,
    errors: LabelErrors,
    reach: float,
) -> tuple[LabelCorrelation, Int64Array]:
    """The correlations of errors, and the cells that frames see by [true form, commonest label], (FORMS, FORMS).

    `truth`: (H, W) life forms on the votes' grid. `forms`: of the labels (`life_form.label_forms`). `errors`: what is
    known of the network; that it errs otherwise here is error too, common to all views. `reach`: standard deviation in
    cells of the Gaussian that weighs pairs of cells. Cameras are taken as views.

    A correlation for which too few cells are seen twice, from one camera or from two, is as high as possible."""
    cells = np.zeros((FORMS, FORMS), np.int64)
    labelled, spread = [], np.ones(FORMS)
    table = np.where(np.isnan(errors.shares), np.eye(FORMS), errors.shares)
    for votes in frames:
        counts = form_counts(votes.counts, forms)
        pixels = counts.sum(axis=1)
        true = truth[votes.rows, votes.cols].astype(np.int64) - 1
        good = (pixels >= LEAST_PIXELS_MEASURED) & (true >= 0) & (true < FORMS)
        rows, cols, counts, pixels, true = (a[good] for a in (votes.rows, votes.cols, counts, pixels, true))
        np.add.at(cells, (true, counts.argmax(axis=1)), 1)
        share, expected = counts / pixels[:, None], table[true]
        # Pairs of two pixels, none with itself.
        alike = (counts * (counts - 1)).sum(axis=1) / (pixels * (pixels - 1))
        within = alike - 2 * (share * expected).sum(axis=1) + (expected**2).sum(axis=1)
        place = rows.astype(np.int64), cols.astype(np.int64)
        labelled.append(FrameErrors(votes.source, *place, true, share - expected, within))
        spread = 1 - (table**2).sum(axis=1)
    if errors.appearance is not None and all(votes.visibility is not None for votes in frames):
        return look_correlation([(looks(frames, truth, forms, errors.appearance), truth.shape)], reach), cells
    return correlation_of_pairs(pair_sums(labelled, truth.shape, spread, reach)), cells
