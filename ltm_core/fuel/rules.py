"""Configure the fuel map (the constants of evidence and decision), and apply those about regions of changed cells."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, Float64Array, UInt8Array
from ltm_core.fuel.life_form import NONBURNABLE

FRAME_CAP = 10.0
"""Maximum number of pixels of one frame in one cell that count as evidence. They see the same plants in the same light,
so a thousand of them add little to a few."""


class DecayYears(StrictModel):
    """Time constants in years after which evidence of a life form has decreased to 1/e."""

    grass: float = Field(2.0, gt=0)
    """Time constant in years for cells of grass."""
    shrub: float = Field(6.0, gt=0)
    """Time constant in years for cells of shrub."""
    tree: float = Field(15.0, gt=0)
    """Time constant in years for cells of tree."""
    bare: float = Field(2.0, gt=0)
    """Time constant in years for bare cells."""
    water: float = Field(10.0, gt=0)
    """Time constant in years for cells of water."""
    built: float = Field(20.0, gt=0)
    """Time constant in years for built-up cells."""
    burned: float = Field(6.0, gt=0)
    """Time constant in years for burned cells. `burned_days` limits how long a cell is shown as burned; after that,
    this applies to what has grown since."""


class FusionRules(StrictModel):
    prior_share: float = Field(0.8, gt=0.5, lt=1)
    """Probability that the prior map is right about a cell's life form."""
    prior_evidence: float = Field(2.5, gt=0)
    """Weight of the prior map in units of evidence; one unit is a pixel that sees a cell perfectly. Weight and share
    decide the probability that the map shows, not whether a cell changes."""
    frame_cap: float = Field(FRAME_CAP, gt=0, le=255)
    """Maximum evidence that one frame can add to one cell."""
    sure: float = Field(0.7, gt=0.5, lt=1)
    """Mean confidence above which labels have full weight. Less confident labels are weighted by the log odds that they
    are right, zero at even odds (the best weights of votes: Nitzan & Paroush, Int. Economic Review 23, 1982), and count
    in proportion to their confidence."""
    context: float = Field(0.15, ge=0, le=1)
    """Weight of the labels of a neighbouring cell of the same stand, relative to a cell's own labels. Cells with the
    same prior code form a stand: plants grow and change by stands, and errors of the network cover smaller areas."""
    context_cells: float = Field(2.0, gt=0, le=8)
    """Standard deviation in cells of the Gaussian by which this weight falls with distance. It is wide enough to
    average a frame's clusters of errors, and narrow enough not to spread a change over its edges."""
    look_s: float = Field(3600.0, gt=0)
    """Seconds after which a frame of the same view is a new observation, because the light has changed."""
    max_sigma: float = Field(300.0, gt=0)
    """Maximum standard deviation of a cell's position in metres; cells with more get no evidence."""
    evidence: float = Field(1.0, gt=0)
    """Minimum evidence for the new life form before a cell changes."""
    odds: float = Field(2.0, ge=1)
    """Minimum likelihood ratio of the new life form to any other before a cell changes, and to its usual one before a
    cell of two forms becomes the other."""
    min_interval_s: float = Field(3600.0, ge=0)
    """Minimum seconds between the first and the last frame that show the new life form, unless two cameras show it."""
    support: float = Field(30.0, ge=0)
    """Minimum sum of log odds of the confident cells about a cell for the same change before it is reported: 15 cells
    of e^2 = 7 to 1. Repeated label errors of one view have lower confidence."""
    sure_odds: float = Field(7.4, ge=1)
    """Odds above which a cell is confident."""
    support_cells: int = Field(8, ge=0, le=16)
    """Distance in cells, to each side, within which confident cells support each other; with 30 m cells, a square of
    510 m."""
    block_cells: int = Field(3, ge=1, le=9)
    """Minimum number of cells that look changed alike in the three by three about a cell, itself included, before it is
    reported. A cell that only favours that life form needs more reported cells than this beside it."""
    mixture: float = Field(0.3, gt=0, le=0.5)
    """Share of the evidence above which both grass and shrub make a grass-shrub cell."""
    burned_days: float = Field(180.0, gt=0)
    """Days for which a cell is burned; after that, it gets the regrowth code."""
    mask: tuple[int, ...] = NONBURNABLE
    """Prior codes that labels never change."""
    decay_years: DecayYears = DecayYears()
    """Time constants of evidence by life form, in years."""


_UNIT: Final = 256
"""Resolution of log odds: they are summed as integers of 1 / _UNIT, so that a part of the map gives the same bits as
the whole."""
GROWTH: Final = 3  # number of cells by which a change grows into its holes and notches
_ENOUGH_COMPANY: Final = 3
"""Number of cells that have changed for other reasons than evidence that is support enough."""


def supported_changes(
    wanted: UInt8Array, log_odds: Float64Array, company: UInt8Array | None, rules: FusionRules, leaning: UInt8Array
) -> BoolArray:
    """Return (H, W) the cells whose change is reported.

    A view errs alike over some cells, but seldom with much certainty over a whole region. So a cell that looks changed
    counts if confident cells of the same change about it have log odds of `rules.support` or more together, and a few
    beside it look changed alike. From there the change grows into holes and notches whose cells lean to it.

    `wanted`: life forms into which cells look changed, 0 none. `log_odds`: by how much their looks make that form
    likelier than any other. `company`: life forms of cells that have changed for other reasons, 0 none. `leaning`:
    likeliest life forms, however little, 0 none."""
    import cv2

    def summed(values: NDArray[Any], side: int) -> NDArray[Any]:
        total = cv2.boxFilter(values, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(total)

    kept = np.zeros(wanted.shape, np.bool_)
    for form in np.unique(wanted[wanted > 0]):
        changed, sums = np.zeros(wanted.shape, np.bool_), np.zeros(wanted.shape, np.float32)
        sure = (wanted == form) & (log_odds >= np.log(rules.sure_odds))
        sums[sure] = np.rint(log_odds[sure] * _UNIT)
        if company is not None:
            changed = company == form
            sums[changed] = np.ceil(rules.support * _UNIT / _ENOUGH_COMPANY)
        region = (wanted == form) & (summed(sums, 2 * rules.support_cells + 1) >= np.floor(rules.support * _UNIT))
        grown = region & (summed((region | changed).astype(np.uint8), 3) >= rules.block_cells)
        for _ in range(GROWTH):
            beside = summed((grown | changed).astype(np.uint8), 3)
            grown |= (region | (leaning == form)) & (beside > rules.block_cells)
        kept |= grown
    return kept
