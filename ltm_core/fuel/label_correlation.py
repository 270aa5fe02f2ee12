"""How a network's label errors hang together, measured on votes whose truth is known.

Of two pixels that see cells of one life form, the labels agree beyond chance by the intraclass correlation. It is
estimated by moments: the mean product of what the shares of labels in two groups of pixels have over the shares that
are known of the network, by that of one pixel with itself (Donner, International Statistical Review 54, 1986).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ltm_core.errors import ImageError
from ltm_core.fuel.label_errors import LabelCorrelation, LabelErrors
from ltm_core.fuel.life_form import FORMS
from ltm_core.fuel.votes import CellVotes

LEAST_PIXELS = 10
"""Of a cell in a frame that is measured."""
_LEAST_PAIRS = 100


def label_correlation(
    frames: Iterable[CellVotes],
    truth: NDArray[np.uint8],
    forms: NDArray[np.int64],
    errors: LabelErrors,
    reach: float,
) -> tuple[LabelCorrelation, NDArray[np.int64]]:
    """The correlations of label errors, and the cells that frames see by [true form, commonest label], (FORMS, FORMS).

    `truth`: (H, W) life forms on the votes' grid. `forms`: of the labels (`life_form.label_forms`). `errors`: what is
    known of the network; that it errs otherwise here is error too, common to all views. `reach`: standard deviation in
    cells of the Gaussian that weighs pairs of cells. Cameras are taken as views.

    Raises ImageError where too few cells are seen twice, from one camera and from two.
    """
    sums: dict[str, NDArray[np.float64]] = {}
    squares: dict[str, NDArray[np.float64]] = {}
    kinds = {kind: np.zeros(2) for kind in ("cell", "stand", "view", "network")}
    table = np.where(np.isnan(errors.shares), np.eye(FORMS), errors.shares)
    by_chance = 1 - (table**2).sum(axis=1)
    cells = np.zeros((FORMS, FORMS), np.int64)
    frames_seen = np.zeros(truth.shape)
    seen: dict[str, NDArray[np.float64]] = {}
    for votes in frames:
        counts = np.zeros((len(votes), FORMS))
        for label, form in enumerate(forms):
            if form >= 0:
                counts[:, form] += votes.counts[:, label]
        pixels = counts.sum(axis=1)
        true = truth[votes.rows, votes.cols].astype(np.int64) - 1
        good = (pixels >= LEAST_PIXELS) & (true >= 0) & (true < FORMS)
        rows, cols, counts, pixels, true = (a[good] for a in (votes.rows, votes.cols, counts, pixels, true))
        share = counts / pixels[:, None]
        np.add.at(cells, (true, counts.argmax(axis=1)), 1)
        over = share - table[true]
        # Pairs of two pixels, none with itself.
        alike = (counts * (counts - 1)).sum(axis=1) / (pixels * (pixels - 1))
        kinds["cell"] += (
            (alike - 2 * (share * table[true]).sum(axis=1) + (table[true] ** 2).sum(axis=1)).sum(),
            by_chance[true].sum(),
        )
        whole = np.zeros((*truth.shape, FORMS))
        whole[rows, cols] = over
        kinds["stand"] += _between_cells(whole, truth, (rows, cols), by_chance, reach)
        name = votes.source
        sums.setdefault(name, np.zeros_like(whole))[rows, cols] += over
        squares.setdefault(name, np.zeros(truth.shape))[rows, cols] += (over**2).sum(axis=1)
        seen.setdefault(name, np.zeros(truth.shape))[rows, cols] += 1
        frames_seen[rows, cols] += 1
    chance = by_chance[np.clip(truth.astype(np.int64) - 1, 0, FORMS - 1)]
    total = np.zeros((*truth.shape, FORMS))
    within, pairs = np.zeros(truth.shape), np.zeros(truth.shape)
    for name, of in sums.items():
        total += of
        own, count = (of**2).sum(axis=-1), seen[name]
        kinds["view"] += ((own - squares[name]).sum(), (count * (count - 1) * chance).sum())
        within += own
        pairs += count**2
    kinds["network"] += (((total**2).sum(axis=-1) - within).sum(), ((frames_seen**2 - pairs) * chance).sum())
    return _correlation(kinds), cells


def _between_cells(
    over: NDArray[np.float64],
    truth: NDArray[np.uint8],
    at: tuple[NDArray[np.int32], NDArray[np.int32]],
    by_chance: NDArray[np.float64],
    reach: float,
) -> NDArray[np.float64]:
    """(2,) of pairs of cells of one form in one frame: sum of products, and of what one pixel has with itself."""
    seen = np.zeros(truth.shape)
    seen[at] = 1
    side = 2 * int(2 * reach + 1) + 1
    impulse = np.zeros((side, side))
    impulse[side // 2, side // 2] = 1
    itself = float(ndimage.gaussian_filter(impulse, reach, mode="constant", truncate=2.0).max())
    product = base = 0.0
    for form in range(FORMS):
        here = seen * (truth == form + 1)
        if here.any():
            mine = over * here[..., None]
            about = ndimage.gaussian_filter(mine, (reach, reach, 0), mode="constant", truncate=2.0)
            pairs = ndimage.gaussian_filter(here, reach, mode="constant", truncate=2.0) - itself
            product += float((mine * (about - itself * mine)).sum())
            base += float((pairs * here).sum() * by_chance[form])
    return np.array([product, base])


def _correlation(kinds: dict[str, NDArray[np.float64]]) -> LabelCorrelation:
    missing = [kind for kind, (_, base) in kinds.items() if base < _LEAST_PAIRS]
    if missing:
        raise ImageError(
            f"too few cells of known truth to measure the correlation of {' and '.join(missing)}: two cameras must see "
            "the same cells, each of them twice"
        )
    value = {kind: float(np.clip(product / base, 0.0, 1.0)) for kind, (product, base) in kinds.items()}
    view = min(value["view"], value["cell"])
    return LabelCorrelation(
        cell=round(value["cell"], 3),
        stand=round(min(value["stand"], value["cell"]), 3),
        view=round(view, 3),
        network=round(min(value["network"], view), 3),
    )
