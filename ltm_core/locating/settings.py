"""What locating assumes where nothing better is known: the `locating` section of a site file."""

from __future__ import annotations

from pydantic import Field

from ltm_core.base.strict_model import StrictModel


class LocatingConfig(StrictModel):
    """Lengths in metres. Which were chosen how, and on what, stands in docs/locating.md."""

    dem_sigma: float = Field(1.0, ge=0)
    """Of the heights of the terrain that the cameras see; a raster whose cells are larger than ten times it has a tenth
    of a cell instead, since what lies between its nodes is not known."""
    plume_height: float = Field(150.0, gt=0)
    """Mean height above its foot of a plume that is noticed; heights are taken for exponentially distributed."""
    plume_lean: float = Field(0.35, ge=0)
    """Sigma of the metres by which a plume's axis drifts, in any one direction, for each that it rises."""
    detection_range: float = Field(10_000.0, gt=0)
    """At which a fire is noticed half as often as close by; the chance falls as 1 / (1 + (r / detection_range)^2)."""
    min_range: float = Field(30.0, ge=3.0)
    """Nothing is looked for nearer: there a camera whose place is half a metre off may mark anything."""
    max_range: float = Field(40_000.0, ge=100.0)
    """Nothing is looked for beyond it."""
    pixel_sigma: float = Field(2.0, gt=0)
    """Pixels by which a marked place is off, in each direction."""
    box_sigma: float = Field(0.04, ge=0)
    """Share of a box's or polygon's height by which its lower edge is off, where that is more."""
    focal_sigma: float = Field(0.002, ge=0)
    """Of the focal length, as a share."""
    false_alarm: float = Field(0.03, gt=0, lt=0.5)
    """Share of one camera's sightings of one thing that are taken for those of two."""
    wrong_odds: float = Field(2.0, gt=0)
    """How many times likelier marks must be with one camera wrong than with none, until cameras disagree."""
    sure_of_wrong: float = Field(0.75, ge=0.5, lt=1)
    """Probability above which a camera is named as turned."""
