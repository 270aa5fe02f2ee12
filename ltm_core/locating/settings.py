"""Configure what locating assumes."""

from pydantic import Field

from ltm_core.base.strict_model import Expert, StrictModel


class LocatingConfig(StrictModel):
    """Settings of locating. Lengths in metres. docs/locating.md describes how the values were chosen."""

    dem_sigma: Expert[float] = Field(1.0, ge=0)
    """Standard deviation of terrain heights in metres. A raster with cells larger than ten times this value has a tenth
    of a cell instead, because heights between its nodes are unknown."""
    plume_height: Expert[float] = Field(150.0, gt=0)
    """Mean height in metres of a plume's top above its base when it is noticed; heights are exponentially distributed.
    """
    plume_lean: Expert[float] = Field(0.35, ge=0)
    """Standard deviation of a plume's horizontal drift in metres per metre of rise, along any one direction."""
    detection_range: Expert[float] = Field(10_000.0, gt=0)
    """Range in metres at which a fire is noticed half as often as nearby. The probability is 1 / (1 + (r /
    detection_range)^2)."""
    min_range: Expert[float] = Field(30.0, ge=3.0)
    """Minimum range in metres to search; nearer, an error of half a metre in the camera's position makes any mark
    possible."""
    max_range: Expert[float] = Field(40_000.0, ge=100.0)
    """Maximum range in metres to search."""
    pixel_sigma: Expert[float] = Field(2.0, gt=0)
    """Standard deviation of a marked pixel in pixels, in each direction."""
    box_sigma: Expert[float] = Field(0.04, ge=0)
    """Standard deviation of the lower edge of a box or polygon, as a share of its height, if this exceeds
    `pixel_sigma`."""
    focal_sigma: Expert[float] = Field(0.002, ge=0)
    """Standard deviation of the focal length, as a share of it."""
    false_alarm: Expert[float] = Field(0.03, gt=0, lt=0.5)
    """Share of a camera's sightings that belong to another object than assumed."""
    wrong_odds: Expert[float] = Field(2.0, gt=0)
    """Odds ratio of one wrong camera against none above which cameras are reported to disagree."""
