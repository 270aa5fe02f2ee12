"""Estimates how strongly a network's label errors correlate within a fuel cell, from votes of known truth.

For two looks at cells of one life form, the agreement of what they show beyond chance is the intraclass correlation.
It is estimated by moments: the mean product of what two looks show beyond what their form lets expect, divided by that
of a look with itself (Donner, International Statistical Review 54, 1986). A look is a pixel's label, expected with the
shares that are known of the network; or the appearance of a whole cell, where that is known
(`cell_appearance_model`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.special import log_softmax

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float64Array, Int64Array, UInt8Array
from ltm_core.fuel.cell_appearance_model import CellAppearanceModel
from ltm_core.fuel.label_errors import LabelCorrelation, LabelErrors
from ltm_core.fuel.life_form import FORMS, form_counts
from ltm_core.fuel.votes import CellVotes
from ltm_lab.evaluation.fuel.cell_appearance_fit import seen_cells

LEAST_PIXELS_MEASURED = 10
"""Least pixels that a cell must have in a frame to be measured."""
_LEAST_PAIRS = 100
_KINDS = ("cell", "stand", "view", "network")


@dataclass(frozen=True, eq=False)
class FrameErrors:
    """Cells of a frame: (N,) rows, columns and index of the true form; (N, FORMS) what they show `beyond` what their
    form lets expect; (N,) the mean product of that of two pixels of the cell.
    """

    source: str
    rows: Int64Array
    cols: Int64Array
    true: Int64Array
    beyond: Float64Array
    within: Float64Array


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

    Raises ImageError where too few cells are seen twice, from one camera and from two.
    """
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
    sums = _pairs(labelled, truth.shape, spread, reach)
    return _correlation(sums), cells


def looks(
    frames: Iterable[CellVotes], truth: UInt8Array, forms: Int64Array, look: CellAppearanceModel
) -> list[FrameErrors]:
    """Of each frame the log likelihoods of its cells' looks, of the forms that are known, in the mean 0."""
    result = []
    known = look.known
    for votes in frames:
        cells = seen_cells([votes], truth, forms, LEAST_PIXELS_MEASURED)
        used = known[cells.true]
        shown = np.zeros((int(used.sum()), FORMS))
        likelihood = look.log_likelihood(cells.seen[used], cells.cosine[used])[:, known]
        shown[:, known] = log_softmax(likelihood, axis=1)
        shown[:, known] -= shown[:, known].mean(axis=1, keepdims=True)
        place = cells.rows[used], cells.cols[used], cells.true[used]
        result.append(FrameErrors(votes.source, *place, shown, (shown**2).sum(axis=1)))
    return result


def look_correlation(sites: Sequence[tuple[list[FrameErrors], tuple[int, ...]]], reach: float) -> LabelCorrelation:
    """Of the looks of cells (`looks`) on one or more sites, with the shapes of their grids. Raises ImageError."""
    true = np.concatenate([frame.true for frames, _ in sites for frame in frames])
    shown = np.concatenate([frame.beyond for frames, _ in sites for frame in frames])
    cells = np.maximum(np.bincount(true, minlength=FORMS), 1)
    expected = np.stack([np.bincount(true, column, FORMS) for column in shown.T], axis=1) / cells[:, None]
    spread = np.bincount(true, ((shown - expected[true]) ** 2).sum(axis=1), FORMS) / cells
    total = np.zeros((len(_KINDS), 2))
    for frames, shape in sites:
        beyond = [replace(f, beyond=f.beyond - expected[f.true]) for f in frames]
        beyond = [replace(f, within=(f.beyond**2).sum(axis=1)) for f in beyond]
        total += _pairs(beyond, shape, spread, reach)
    return _correlation(total)


def _pairs(frames: Iterable[FrameErrors], shape: tuple[int, ...], spread: Float64Array, reach: float) -> Float64Array:
    """(4, 2) of each kind of pair: the sum of products, and of what a look has with itself, `spread` (FORMS,)."""
    kinds = np.zeros((len(_KINDS), 2))
    cell, stand, view, network = kinds
    chance, frames_seen, total = np.zeros(shape), np.zeros(shape), np.zeros((*shape, FORMS))
    sums: dict[str, Float64Array] = {}
    squares: dict[str, Float64Array] = {}
    seen: dict[str, Float64Array] = {}
    for frame in frames:
        at, name = (frame.rows, frame.cols), frame.source
        chance[at] = spread[frame.true]
        cell += frame.within.sum(), spread[frame.true].sum()
        stand += _between_cells(frame, shape, spread, reach)
        sums.setdefault(name, np.zeros_like(total))[at] += frame.beyond
        squares.setdefault(name, np.zeros(shape))[at] += (frame.beyond**2).sum(axis=1)
        seen.setdefault(name, np.zeros(shape))[at] += 1
        frames_seen[at] += 1
    within, pairs = np.zeros(shape), np.zeros(shape)
    for name, of in sums.items():
        total += of
        own, count = (of**2).sum(axis=-1), seen[name]
        view += (own - squares[name]).sum(), (count * (count - 1) * chance).sum()
        within += own
        pairs += count**2
    network += ((total**2).sum(axis=-1) - within).sum(), ((frames_seen**2 - pairs) * chance).sum()
    return kinds


def _between_cells(frame: FrameErrors, shape: tuple[int, ...], spread: Float64Array, reach: float) -> Float64Array:
    """(2,) of pairs of cells of one form in one frame: sum of products, and of what one look has with itself."""
    side = 2 * int(2 * reach + 1) + 1
    impulse = np.zeros((side, side))
    impulse[side // 2, side // 2] = 1
    itself = float(ndimage.gaussian_filter(impulse, reach, mode="constant", truncate=2.0).max())
    product = base = 0.0
    for form in np.unique(frame.true):
        of = frame.true == form
        here, mine = np.zeros(shape), np.zeros((*shape, FORMS))
        here[frame.rows[of], frame.cols[of]] = 1
        mine[frame.rows[of], frame.cols[of]] = frame.beyond[of]
        about = ndimage.gaussian_filter(mine, (reach, reach, 0), mode="constant", truncate=2.0)
        pairs = ndimage.gaussian_filter(here, reach, mode="constant", truncate=2.0) - itself
        product += float((mine * (about - itself * mine)).sum())
        base += float((pairs * here).sum() * spread[form])
    return np.array([product, base])


def _correlation(kinds: Float64Array) -> LabelCorrelation:
    missing = [kind for kind, (_, base) in zip(_KINDS, kinds, strict=True) if base < _LEAST_PAIRS]
    if missing:
        raise ImageError(
            f"too few cells of known truth to measure the correlation of {' and '.join(missing)}: two cameras must see "
            "the same cells, each of them twice"
        )
    cell, stand, view, network = (float(np.clip(product / base, 0.0, 1.0)) for product, base in kinds)
    view = min(view, cell)
    return LabelCorrelation(
        cell=round(cell, 3), stand=round(min(stand, cell), 3), view=round(view, 3), network=round(min(network, view), 3)
    )
