"""Typed configuration of the fuel map: every constant of evidence and decision, with its reason."""

from __future__ import annotations

from pydantic import Field

from ltm_core.fuel.life_form import NONBURNABLE
from ltm_core.strict_model import StrictModel

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
    sure: float = Field(0.7, gt=0, le=1)
    """Mean confidence of labels from which on they weigh fully; less confident ones weigh in proportion."""
    context: float = Field(0.2, ge=0, le=1)
    """What the labels of a cell of the same stand say for a cell that lies beside it, beside its own labels. A stand is
    where the prior map says the same: plants grow and change by stands, and the network errs by smaller pieces."""
    context_cells: float = Field(3.0, gt=0, le=8)
    """Standard deviation of the Gaussian by which that falls with distance."""
    look_s: float = Field(3600.0, gt=0)
    """Seconds after which the light has moved on so far that a frame of the same view is another look."""
    relief: float = Field(2.0, ge=0)
    """Metres by which plants stand above the terrain that their pixels are traced to; it displaces along the sight."""
    max_sigma: float = Field(300.0, gt=0)
    """Metres; cells that are placed worse get no evidence."""
    posterior: float = Field(0.8, gt=0.5, lt=1)
    """Probability that the new life form is the commonest in the cell, before the cell changes."""
    min_interval_s: float = Field(3600.0, ge=0)
    """Between the first and the last frame that show the new life form; or two cameras show it."""
    min_evidence: float = Field(4.0, ge=0)
    """For the new life form."""
    min_cells: int = Field(8, ge=1, le=100)
    """Minimum mapping unit: a connected region that changes into one life form counts from so many cells on (of 30 m:
    0.7 ha). Stands change in larger pieces, and what a network mislabels along their edges lies in smaller ones."""
    mixture: float = Field(0.3, gt=0, le=0.5)
    """Share of the evidence above which both grass and shrub make a grass-shrub cell."""
    burned_days: float = Field(180.0, gt=0)
    """A burned cell's time to live; after it, the regrowth code."""
    mask: tuple[int, ...] = NONBURNABLE
    """Prior codes that labels never change."""
    decay_years: DecayYears = DecayYears()
