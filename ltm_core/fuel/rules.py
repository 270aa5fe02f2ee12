"""Typed configuration of the fuel map: every constant of evidence and decision, with its reason."""

from __future__ import annotations

from pydantic import Field

from ltm_core.base.strict_model import StrictModel
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
