"""Measure a label network on the recording of a site: appearance of its cells, confusion, correlation of its errors.

The prior map is the truth of most cells, and a noisy one. `measure_labels` therefore estimates the true form of each
cell and the look of each form in turn, as the expectation maximisation of Dawid and Skene (Applied Statistics 28, 1979)
does with raters: the prior map, another network whose errors are known, and the network itself. Only regions of change
that are sure together count against the prior. Cells beside them teach nothing, because a region is seldom found to its
edges.

Errors of two looks at cells of one life form agree beyond chance by their intraclass correlation: the mean product of
what two looks show beyond what their form lets expect, divided by that of a look with itself (Donner, International
Statistical Review 54, 1986)."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import scipy  # loads its parts when they are first used

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float64Array, Int16Array, Int64Array, UInt8Array
from ltm_core.fuel.cell_appearance_model import SEEN, CellAppearanceModel, at_incidence, away_from_camera, what_is_seen
from ltm_core.fuel.label_errors import LabelCorrelation, LabelErrors
from ltm_core.fuel.life_form import FORMS, LifeForm, form_counts, forms_of
from ltm_core.fuel.votes import CellVotes

LEAST_PIXELS_MEASURED = 10
"""Least pixels that a cell must have in a frame to be measured."""
_LEAST_PAIRS = 100
_KINDS = ("cell", "stand", "view", "network")
_IN_SAMPLE: Final = 1.25
"""Ratio of the correlation within stands on sites that taught nothing to that on the site that taught (rendered sites;
the shipped records use it too)."""
_LASTING: Final = 0.9
"""Least correlation of two frames of a view. A recording of minutes or hours has one light and one season, and cannot
show how errors change with them; that of the shipped networks is 0.94 and 0.95."""
_ROUNDS: Final = 4
"""Maximum number of rounds in which the network's own changes correct the prior; they settle in two or three."""
_MOST_CHANGED: Final = 0.2
"""Share of the cells that may have changed; beyond it the prior map is no truth to measure by."""
_UNCONFIRMED: Final = 0.01
"""Maximum share of the cells that may change beyond what the known network finds, before one view alone counts 0."""
INCIDENCE = (0.05, 0.5)
"""Cosines: from 3 degrees over the ground to 30."""
LEAST_PIXELS_LEARNT = 3
"""Least pixels that a cell must have in a frame to be learnt from."""
LEAST_CELLS = 150
"""Of a form, over all frames, before it counts as known."""
_RAREST = 8.0  # most by which cells with an unusual form in front of them count more
_RIDGE = 3.0
"""Penalty of squared weights, which keeps those that little is known of near zero."""


@dataclass(frozen=True, eq=False)
class SeenCells:
    """Cells of known form as frames saw them: (N,) rows, columns, index of the true form and id of the form in
    front of it, 0 unknown; (N, SEEN) what is seen, (N,) cosine of incidence."""

    rows: Int64Array
    cols: Int64Array
    true: Int64Array
    front: Int64Array
    seen: Float64Array
    cosine: Float64Array


def seen_cells(
    frames: Iterable[CellVotes], truth: UInt8Array, forms: Int64Array, least: int = LEAST_PIXELS_LEARNT
) -> SeenCells:
    """The cells of one site's frames that have `least` pixels. `truth`: (H, W) life forms on the votes' grid. `forms`:
    of the labels (`life_form.label_forms`). Raises ImageError for votes without a visibility."""
    parts = []
    for votes in frames:
        if votes.visibility is None:
            raise ImageError(f"votes of {votes.source} have no incidence, footprint and position error of their cells")
        counts = form_counts(votes.counts, forms)
        pixels = counts.sum(axis=1)
        votes, counts, pixels = votes.only(pixels > 0), counts[pixels > 0], pixels[pixels > 0]
        assert votes.visibility is not None  # nosec B101 # tells the type checker what holds
        rows, cols = votes.rows.astype(np.int64), votes.cols.astype(np.int64)
        seen = what_is_seen(rows, cols, counts / pixels[:, None], votes.visibility.bearing, votes.confidence)
        true = truth[rows, cols].astype(np.int64) - 1
        down, right = away_from_camera(votes.visibility.bearing)
        front = np.pad(truth, 1)[rows - down + 1, cols - right + 1].astype(np.int64)
        front[front > FORMS] = 0
        good = (pixels >= least) & (true >= 0) & (true < FORMS)
        cosine = votes.visibility.cos_incidence.astype(np.float64)
        parts.append([column[good] for column in (rows, cols, true, front, seen, cosine)])
    if not parts:
        raise ImageError("no frame to learn the looks of cells from")
    return SeenCells(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def fit_softmax(
    inputs: Float64Array,
    truth: Float64Array,
    weight: Float64Array,
    ridge: Float64Array | float,
    offset: Float64Array | float = 0.0,
) -> Float64Array:
    """Return the weights (S, K) of a logistic regression of classes `truth` (N, K), 0 or 1, on `inputs` (N, S). It
    minimises the log loss, in which samples count by `weight` (N,), plus half of `ridge`, by input, times the squared
    weights. `offset`: (N, K) of the scores."""
    shape = inputs.shape[1], truth.shape[1]

    def loss(flat: Float64Array) -> tuple[float, Float64Array]:
        weights = flat.reshape(shape)
        log_p = scipy.special.log_softmax(offset + inputs @ weights, axis=1)
        value = -float(weight @ (truth * log_p).sum(axis=1)) + float((ridge * weights**2).sum()) / 2
        slope = inputs.T @ (weight[:, None] * (np.exp(log_p) - truth)) + ridge * weights
        return value, slope.ravel()

    start = np.zeros(shape).ravel()
    found = scipy.optimize.minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 300})
    return np.asarray(found.x.reshape(shape), np.float64)


def fit_cell_appearance(sites: Sequence[SeenCells]) -> CellAppearanceModel:
    """Logistic regression over the cells of all sites; each site weighs the same, and so does each form, with the same
    forms in front of it: which forms follow each other along a line of sight is for the map to say, else the looks
    repeat it. Raises ImageError where fewer than two forms have cells enough."""
    cells = np.sum([np.bincount(site.true, minlength=FORMS) for site in sites], axis=0)
    known = np.flatnonzero(cells >= LEAST_CELLS)
    if len(known) < 2:
        raise ImageError(f"fewer than two life forms have {LEAST_CELLS} cells to learn from: {cells.tolist()}")
    knots = np.array(INCIDENCE)
    inputs = np.concatenate([at_incidence(site.seen, site.cosine, knots) for site in sites])
    true, front = (np.concatenate([getattr(site, name) for site in sites]) for name in ("true", "front"))
    used = np.isin(true, known)
    weight = np.concatenate([np.full(len(site.true), 1 / max(len(site.true), 1)) for site in sites])[used]
    inputs, true, front = inputs[used], true[used], front[used]
    weight /= np.bincount(true, weight, FORMS)[true]
    pairs = np.bincount(true * (FORMS + 1) + front, weight, FORMS * (FORMS + 1)).reshape(FORMS, -1)
    weight *= np.clip(pairs[known].mean(axis=0) / np.maximum(pairs, 1e-9), 1 / _RAREST, _RAREST)[true, front]
    weight *= len(true) / len(known) / np.bincount(true, weight, FORMS)[true]
    found = fit_softmax(inputs, (true[:, None] == known).astype(np.float64), weight, _RIDGE)
    names = [LifeForm(form + 1).name.lower() for form in known.tolist()]
    weights = dict(zip(names, found.T.reshape(len(known), len(INCIDENCE), SEEN).tolist(), strict=True))
    return CellAppearanceModel(incidence=INCIDENCE, weights=weights)


@dataclass(frozen=True, eq=False)
class FrameErrors:
    """Cells of a frame: (N,) rows, columns and index of the true form; (N, FORMS) what they show `beyond` what their
    form lets expect; (N,) the mean product of that of two pixels of the cell."""

    source: str
    rows: Int64Array
    cols: Int64Array
    true: Int64Array
    beyond: Float64Array
    within: Float64Array


def looks(
    frames: Iterable[CellVotes], truth: UInt8Array, forms: Int64Array, look: CellAppearanceModel
) -> list[FrameErrors]:
    """Of each frame the log likelihoods of its cells' looks, of the forms that are known, in the mean 0."""
    result, known = [], look.known
    for votes in frames:
        cells = seen_cells([votes], truth, forms, LEAST_PIXELS_MEASURED)
        used = known[cells.true]
        shown = np.zeros((int(used.sum()), FORMS))
        likelihood = scipy.special.log_softmax(look.log_likelihood(cells.seen[used], cells.cosine[used])[:, known], 1)
        shown[:, known] = likelihood - likelihood.mean(axis=1, keepdims=True)
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
        beyond = [f.beyond - expected[f.true] for f in frames]
        both = zip(frames, beyond, strict=True)
        total += pair_sums([replace(f, beyond=b, within=(b**2).sum(axis=1)) for f, b in both], shape, spread, reach)
    return correlation_of_pairs(total)


def pair_sums(
    frames: Iterable[FrameErrors], shape: tuple[int, ...], spread: Float64Array, reach: float
) -> Float64Array:
    """(4, 2) of each kind of pair: the sum of products, and of what a look has with itself, `spread` (FORMS,)."""
    kinds = np.zeros((len(_KINDS), 2))
    cell, stand, view, network = kinds
    chance, frames_seen, total = np.zeros(shape), np.zeros(shape), np.zeros((*shape, FORMS))
    by_view: dict[str, tuple[Float64Array, Float64Array, Float64Array]] = {}
    for frame in frames:
        at = frame.rows, frame.cols
        if frame.source not in by_view:
            by_view[frame.source] = np.zeros_like(total), np.zeros(shape), np.zeros(shape)
        sums, squares, seen = by_view[frame.source]
        chance[at] = spread[frame.true]
        cell += frame.within.sum(), spread[frame.true].sum()
        stand += _between_cells(frame, shape, spread, reach)
        sums[at] += frame.beyond
        squares[at] += (frame.beyond**2).sum(axis=1)
        seen[at] += 1
        frames_seen[at] += 1
    within, pairs = np.zeros(shape), np.zeros(shape)
    for sums, squares, seen in by_view.values():
        total += sums
        own = (sums**2).sum(axis=-1)
        view += (own - squares).sum(), (seen * (seen - 1) * chance).sum()
        within += own
        pairs += seen**2
    network += ((total**2).sum(axis=-1) - within).sum(), ((frames_seen**2 - pairs) * chance).sum()
    return kinds


def _between_cells(frame: FrameErrors, shape: tuple[int, ...], spread: Float64Array, reach: float) -> Float64Array:
    """(2,) of pairs of cells of one form in one frame: sum of products, and of what one look has with itself."""
    side = 2 * int(2 * reach + 1) + 1
    impulse = np.zeros((side, side))
    impulse[side // 2, side // 2] = 1
    itself = float(scipy.ndimage.gaussian_filter(impulse, reach, mode="constant", truncate=2.0).max())
    product = base = 0.0
    for form in np.unique(frame.true):
        of = frame.true == form
        here, mine = np.zeros(shape), np.zeros((*shape, FORMS))
        here[frame.rows[of], frame.cols[of]] = 1
        mine[frame.rows[of], frame.cols[of]] = frame.beyond[of]
        about = scipy.ndimage.gaussian_filter(mine, (reach, reach, 0), mode="constant", truncate=2.0)
        pairs = scipy.ndimage.gaussian_filter(here, reach, mode="constant", truncate=2.0) - itself
        product += float((mine * (about - itself * mine)).sum())
        base += float((pairs * here).sum() * spread[form])
    return np.array([product, base])


def correlation_of_pairs(kinds: Float64Array) -> LabelCorrelation:
    """Return the correlations from the sums (4, 2) of `pair_sums`. A kind with too few pairs is as high as possible:
    two frames of a view, and two cells of a stand, then err alike, and two views as two frames of one."""
    cell, stand, view, network = (
        float(np.clip(product / base, 0.0, 1.0)) if base >= _LEAST_PAIRS else 1.0 for product, base in kinds
    )
    view = min(view, cell)
    return LabelCorrelation(
        cell=round(cell, 3), stand=round(min(stand, cell), 3), view=round(view, 3), network=round(min(network, view), 3)
    )


def measure_labels(
    votes: Sequence[CellVotes],
    codes: Int16Array,
    forms: Int64Array,
    reach: float,
    changes: Callable[[LabelErrors], UInt8Array],
    known: UInt8Array | None,
    source: str,
) -> LabelErrors:
    """Return the label errors of a network by its votes for the cells of a prior map with `codes` (H, W).

    Args:
        forms: of the labels (`life_form.label_forms`).
        reach: standard deviation in cells of the Gaussian that weighs pairs of cells (`FusionRules.context_cells`).
        changes: returns (H, W) the life forms of the cells that the map of these votes changes, 0 elsewhere.
        known: the same by another network whose errors are known; None: there is none. It is ignored if it changes
            more than can have changed: it does not know this land.

    Raises ImageError for too few cells, and if too many have changed for the prior map to be a truth."""
    held = forms_of(codes)
    prior = np.where(held.sum(axis=-1) == 1, held.argmax(axis=-1) + 1, 255).astype(np.uint8)
    seen = np.zeros(codes.shape, np.bool_)
    for frame in votes:
        seen[frame.rows, frame.cols] = True
    if known is not None and (known[seen] > 0).sum() > _MOST_CHANGED * seen.sum():
        known = None
    changed = np.zeros_like(prior) if known is None else known
    for _ in range(1 if known is not None else _ROUNDS):
        if (share := (changed[seen] > 0).sum() / max(seen.sum(), 1)) > _MOST_CHANGED:
            raise ImageError(
                f"{share:.0%} of the seen cells differ from the prior map; measure on frames from before the change, "
                "or give a newer prior map"
            )
        beside = scipy.ndimage.binary_dilation(changed > 0, np.ones((3, 3)))
        truth = np.where(changed > 0, changed, np.where(beside, 255, prior)).astype(np.uint8)
        cells = seen_cells(votes, truth, forms)
        appearance = fit_cell_appearance([cells])
        correlation = look_correlation([(looks(votes, truth, forms, appearance), truth.shape)], reach)
        stand = round(min(correlation.stand * _IN_SAMPLE, correlation.cell), 3)
        view = min(max(correlation.view, _LASTING), correlation.cell)
        correlation = correlation.model_copy(update={"stand": stand, "view": view})
        count = np.bincount(cells.true, minlength=FORMS)
        shares = np.full((FORMS, FORMS), np.nan)
        for form in np.flatnonzero(count >= LEAST_CELLS):
            row = cells.seen[cells.true == form, 1 : 1 + FORMS].sum(axis=0)
            shares[form] = row / row.sum()
        errors = LabelErrors(shares, correlation, source, appearance)
        before, changed = changed, changes(errors) if known is None else known
        if np.array_equal(before, changed):
            break
    if known is None:
        # Nothing else confirms it: the design effect of two views.
        return replace(errors, one_view=round(1 / (1 + errors.correlation.between_views), 3))
    unconfirmed = (changes(errors)[seen] > 0) & (known[seen] == 0)
    return replace(errors, one_view=float(unconfirmed.mean() <= _UNCONFIRMED))
