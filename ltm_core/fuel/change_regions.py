"""Report changed cells only in regions that are certain enough, by the constants of the fuel map."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np
from pydantic import Field

from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, Float64Array, UInt8Array
from ltm_core.fuel.life_form import NONBURNABLE

FRAME_CAP = 10.0
"""Pixels of one frame in one cell that count as evidence at most: they see the same plants under the same light, so a
thousand of them say hardly more than a few."""


class DecayYears(StrictModel):
    """Time constants after which evidence of a life form has shrunk to 1/e: how long what a camera saw stays true."""

    grass: float = Field(2.0, gt=0)
    shrub: float = Field(6.0, gt=0)
    tree: float = Field(15.0, gt=0)
    bare: float = Field(2.0, gt=0)
    water: float = Field(10.0, gt=0)
    built: float = Field(20.0, gt=0)
    burned: float = Field(6.0, gt=0)
    """That it has burned: how long it looks burned is `burned_days`, and then it is what has grown since."""


class FusionRules(StrictModel):
    prior_share: float = Field(0.8, gt=0.5, lt=1)
    """Probability that the prior map is right about a cell's life form."""
    prior_evidence: float = Field(2.5, gt=0)
    """What the prior map weighs, in the unit of evidence: one unit is a pixel that sees a cell perfectly."""
    frame_cap: float = Field(FRAME_CAP, gt=0, le=255)
    """Evidence that one frame can give for one cell at most."""
    sure: float = Field(0.7, gt=0.5, lt=1)
    """Mean confidence of labels from which on they weigh fully. What less confident ones say of a life form weighs by
    the log odds that they are right, nothing at even odds (the best weights of votes: Nitzan & Paroush, Int. Economic
    Review 23, 1982), and counts in proportion to their confidence."""
    context: float = Field(0.15, ge=0, le=1)
    """What the labels of a cell of the same stand say for a cell that lies beside it, beside its own labels. A stand is
    where the prior map says the same: plants grow and change by stands, and the network errs by smaller pieces."""
    context_cells: float = Field(2.0, gt=0, le=8)
    """Standard deviation of the Gaussian by which that falls with distance: wide enough to average a frame's clumps of
    errors, and not so wide that a change spreads over its edges."""
    look_s: float = Field(3600.0, gt=0)
    """Seconds after which the light has moved on so far that a frame of the same view is another look."""
    relief: float = Field(2.0, ge=0)
    """Metres by which plants stand above the terrain that their pixels are traced to; it displaces along the sight."""
    max_sigma: float = Field(300.0, gt=0)
    """Metres; cells that are placed worse get no evidence."""
    posterior: float = Field(0.72, gt=0.5, lt=1)
    """Probability that the new life form is the commonest in the cell, before the cell changes."""
    odds: float = Field(2.0, ge=1)
    """How many times likelier than any other form looks must make the new one, before the cell changes. Not to be
    reported alone: see `support`."""
    min_interval_s: float = Field(3600.0, ge=0)
    """Between the first and the last frame that show the new life form; or two cameras show it."""
    min_evidence: float = Field(2.0, ge=0)
    """For the new life form."""
    support: float = Field(8.0, ge=0)
    """Log odds that the sure cells about a cell must have together for the same change, before any of them is reported:
    two cells of e^4 = 55 to 1 or four of e^2 = 7 to 1. What one view mislabels time and again, it mislabels
    with less certainty."""
    sure_odds: float = Field(7.4, ge=1)
    """From which odds on a cell is sure."""
    support_cells: int = Field(4, ge=0, le=16)
    """To each side, how far about a cell sure ones support it: of 30 m cells, a square of 270 m."""
    grow_cells: int = Field(6, ge=0, le=32)
    """Steps by which a region that is supported is reported beyond, over cells that hang together with it."""
    fill_cells: int = Field(5, ge=4, le=8)
    """Of the eight cells about one, how many must be reported before it is reported with them, though its own looks are
    less sure than a change asks for, if only they make that form likelier than any other. Three are a straight edge's.
    """
    fill_evidence: float = Field(1.0, gt=0)
    """Evidence for that form that such a cell needs of its own."""
    fill_rounds: int = Field(2, ge=0, le=8)
    """Rounds in which such cells are reported, each with those of the round before; 0: none are."""
    min_cells: int = Field(3, ge=1, le=100)
    """Minimum mapping unit: a connected region that changes into one life form counts from so many cells on (of 30 m:
    0.27 ha)."""
    mixture: float = Field(0.3, gt=0, le=0.5)
    """Share of the evidence above which both grass and shrub make a grass-shrub cell."""
    burned_days: float = Field(180.0, gt=0)
    """A burned cell's time to live; after it, the regrowth code."""
    mask: tuple[int, ...] = NONBURNABLE
    """Prior codes that labels never change."""
    decay_years: DecayYears = DecayYears()


_UNIT: Final = 256
"""Log odds are summed in whole numbers of 1 / _UNIT: of a part of the map they are then the whole map's, to the bit."""
_ABOUT: Final = np.ones((3, 3), np.uint8)
"""A cell and those beside it, by sides and corners."""


def supported_changes(
    wanted: UInt8Array,
    log_odds: Float64Array,
    company: UInt8Array | None,
    rules: FusionRules,
    leaning: UInt8Array | None = None,
) -> BoolArray:
    """(H, W): the cells of `wanted` whose change is to be reported.

    A view errs alike over some cells, but seldom with much certainty over a whole region, and plants change by
    regions. So a cell that looks changed counts where sure cells of the same change about it have log odds of
    `rules.support` or more together, and so do those that hang together with it within `rules.grow_cells`: a sure
    region is reported as far as it goes, an unsure one not at all (hysteresis: Canny, IEEE PAMI 8, 1986). A cell that
    only leans to what most of those about it have become is reported with them: stands that the network mislabels are
    holes in what has changed.

    `wanted`: life forms into which cells look changed, 0 none. `log_odds`: by how much their looks make that form
    likelier than any other. `company`: life forms of cells that have changed for other reasons than looks, 0 none:
    `rules.min_cells` of them are support enough. `leaning`: life forms that cells look like rather than any other, be
    it ever so little, 0 none.
    """
    kept = np.zeros(wanted.shape, np.bool_)
    for form in np.unique(wanted[wanted > 0]):
        members, sums = wanted == form, np.zeros(wanted.shape, np.float32)
        sure = members & (log_odds >= np.log(rules.sure_odds))
        sums[sure] = np.rint(log_odds[sure] * _UNIT)
        if company is not None:
            members = members | (company == form)
            sums[company == form] = np.ceil(rules.support * _UNIT / rules.min_cells)
        side = 2 * rules.support_cells + 1
        total = cv2.boxFilter(sums, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        region = members & (total >= np.floor(rules.support * _UNIT))
        for _ in range(rules.grow_cells):
            region = members & (cv2.dilate(region.astype(np.uint8), _ABOUT) > 0)
        region &= _large(members, rules.min_cells)
        if leaning is not None:
            region = _filled(region, leaning == form, rules)
        kept |= region
    return kept


def _filled(region: BoolArray, leaning: BoolArray, rules: FusionRules) -> BoolArray:
    """(H, W): with cells of `leaning` that have so many of `region` about them."""
    for _ in range(rules.fill_rounds):
        about = cv2.boxFilter(region.astype(np.uint8), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        region = region | (leaning & (about >= rules.fill_cells))
    return region


def reach_of(rules: FusionRules) -> int:
    """Cells out to which others have a say in whether the change of a cell is reported."""
    support = rules.support_cells + rules.grow_cells if rules.support > 0 else 0
    return max(support, rules.min_cells - 1) + rules.fill_rounds


def _large(members: BoolArray, least: int) -> BoolArray:
    """(H, W): cells of connected regions (by sides and corners) of `least` cells or more."""
    _, regions = cv2.connectedComponents(members.astype(np.uint8), connectivity=8)
    large = np.bincount(regions.ravel()) >= least
    large[0] = False
    return np.asarray(large[regions])
