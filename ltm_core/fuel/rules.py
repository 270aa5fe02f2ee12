"""Configure the fuel map (the constants of evidence and decision), and apply those about regions of changed cells."""

from typing import Final

import numpy as np
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
    """Weight of the prior map in units of evidence; one unit is a pixel that sees a cell perfectly."""
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
    posterior: float = Field(0.72, gt=0.5, lt=1)
    """Minimum probability that the new life form is the most common one in a cell before the cell changes."""
    odds: float = Field(2.0, ge=1)
    """Minimum likelihood ratio of the new life form to any other before a cell changes. A change of a single cell also
    needs `support`."""
    min_interval_s: float = Field(3600.0, ge=0)
    """Minimum seconds between the first and the last frame that show the new life form, unless two cameras show it."""
    support: float = Field(8.0, ge=0)
    """Minimum sum of log odds of the confident neighbouring cells for the same change before any of them is reported:
    two cells of e^4 = 55 to 1 or four of e^2 = 7 to 1. Repeated label errors of one view have lower confidence."""
    sure_odds: float = Field(7.4, ge=1)
    """Odds above which a cell is confident."""
    support_cells: int = Field(4, ge=0, le=16)
    """Distance in cells, to each side, within which confident cells support each other; with 30 m cells, a square of
    270 m."""
    grow_cells: int = Field(6, ge=0, le=32)
    """Maximum number of steps by which a supported region grows over connected cells."""
    fill_cells: int = Field(5, ge=4, le=8)
    """Minimum number of reported neighbours, of eight, for a cell to be reported with them, if its own observations
    favour that life form but are not conclusive. Three neighbours form a straight edge."""
    fill_evidence: float = Field(1.0, gt=0)
    """Minimum evidence of a cell for the life form of its reported neighbours."""
    fill_rounds: int = Field(2, ge=0, le=8)
    """Number of rounds in which cells are added to their reported neighbours; 0: none."""
    min_cells: int = Field(3, ge=1, le=100)
    """Minimum mapping unit in cells: a connected region that changes to one life form counts from this size (3 cells of
    30 m: 0.27 ha)."""
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

    A view errs alike over some cells, but seldom with much certainty over a whole region. So a cell that looks changed
    counts if confident cells of the same change about it have log odds of `rules.support` or more together, and so do
    those connected to it within `rules.grow_cells` (hysteresis: Canny, IEEE PAMI 8, 1986). A cell that only leans to
    what most of those about it have become is reported with them.

    `wanted`: life forms into which cells look changed, 0 none. `log_odds`: by how much their looks make that form
    likelier than any other. `company`: life forms of cells that have changed for other reasons, 0 none:
    `rules.min_cells` of them are support enough. `leaning`: likeliest life forms, however little, 0 none."""
    import cv2

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
        _, regions = cv2.connectedComponents(members.astype(np.uint8), connectivity=8)
        large = np.bincount(regions.ravel()) >= rules.min_cells
        region &= large[regions]
        for _ in range(0 if leaning is None else rules.fill_rounds):
            near = cv2.boxFilter(region.astype(np.uint8), -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
            region = region | ((leaning == form) & (near >= rules.fill_cells))
        kept |= region
    return kept


def reach_of(rules: FusionRules) -> int:
    """Return the distance in cells within which others influence whether a change is reported."""
    support = rules.support_cells + rules.grow_cells if rules.support > 0 else 0
    return max(support, rules.min_cells - 1) + rules.fill_rounds
