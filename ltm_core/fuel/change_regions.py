"""Report changed cells only in regions that are certain enough, by the constants of the fuel map."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Float64Array, UInt8Array
from ltm_core.fuel.rules import FusionRules

_UNIT: Final = 256
"""Resolution of log odds: they are summed as integers of 1 / _UNIT, so that a part of the map gives the same bits as
the whole."""
_ABOUT: Final = np.ones((3, 3), np.uint8)
"""A cell and its eight neighbours."""


def supported_changes(
    wanted: UInt8Array,
    log_odds: Float64Array,
    company: UInt8Array | None,
    rules: FusionRules,
    leaning: UInt8Array | None = None,
) -> BoolArray:
    """Return (H, W) the cells of `wanted` whose change is reported.

    A view errs alike over some cells, but seldom with much certainty over a whole region, and plants change by
    regions. So a cell that looks changed counts where sure cells of the same change about it have log odds of
    `rules.support` or more together, and so do those connected to it within `rules.grow_cells`: a certain
    region is reported completely, an uncertain one not at all (hysteresis: Canny, IEEE PAMI 8, 1986). A cell that
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
    """Return (H, W) `region` with cells of `leaning` that have enough neighbours in it."""
    for _ in range(rules.fill_rounds):
        about = cv2.boxFilter(region.astype(np.uint8), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
        region = region | (leaning & (about >= rules.fill_cells))
    return region


def reach_of(rules: FusionRules) -> int:
    """Return the distance in cells within which others influence whether a change is reported."""
    support = rules.support_cells + rules.grow_cells if rules.support > 0 else 0
    return max(support, rules.min_cells - 1) + rules.fill_rounds


def _large(members: BoolArray, least: int) -> BoolArray:
    """Return (H, W): cells of connected regions (by sides and corners) of `least` cells or more."""
    _, regions = cv2.connectedComponents(members.astype(np.uint8), connectivity=8)
    large = np.bincount(regions.ravel()) >= least
    large[0] = False
    return np.asarray(large[regions])
