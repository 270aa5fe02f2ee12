"""How evidence becomes a map: every constant of the fusion, with its reason."""

from __future__ import annotations

from pydantic import Field

from ltm_core.fuel.life_form import NONBURNABLE
from ltm_core.fuel.votes import FRAME_CAP
from ltm_core.vision.strict import StrictModel


class DecayYears(StrictModel):
    """Time constants after which evidence of a life form has shrunk to 1/e: how long what a camera saw stays true.

    At least a quarter of a year, so that float64 holds evidence of any date until 2106.
    """

    grass: float = Field(2.0, ge=0.25)
    shrub: float = Field(6.0, ge=0.25)
    tree: float = Field(15.0, ge=0.25)
    bare: float = Field(2.0, ge=0.25)
    water: float = Field(10.0, ge=0.25)
    built: float = Field(20.0, ge=0.25)
    burned: float = Field(0.5, ge=0.25)


class FusionRules(StrictModel):
    prior_share: float = Field(0.8, gt=0.5, lt=1)
    """Probability that the prior map is right about a cell's life form."""
    prior_evidence: float = Field(6.0, gt=0)
    """What the prior map weighs, in the unit of evidence: one unit is a pixel that sees a cell perfectly."""
    frame_cap: float = Field(FRAME_CAP, gt=0)
    """Evidence that one frame can give for one cell at most."""
    sure: float = Field(0.7, gt=0, le=1)
    """Mean confidence of labels from which on they weigh fully; less confident ones weigh in proportion."""
    label_correlation: float = Field(0.2, ge=0, le=1)
    """Of a network's errors within one cell of one frame: n pixels say as much as n / (1 + (n - 1) correlation)
    independent ones (Kish's design effect)."""
    context: float = Field(0.15, ge=0, le=1)
    """What the labels of each of the eight cells about a cell in the same frame say for it, beside its own."""
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
    mixture: float = Field(0.3, gt=0, le=0.5)
    """Share of the evidence above which both grass and shrub make a grass-shrub cell."""
    burned_days: float = Field(180.0, gt=0)
    """A burned cell's time to live; after it, the regrowth code."""
    mask: tuple[int, ...] = NONBURNABLE
    """Prior codes that labels never change."""
    decay_years: DecayYears = DecayYears()
