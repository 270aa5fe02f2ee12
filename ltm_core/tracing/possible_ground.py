"""Bound the ground height that a DEM does not know: in its holes, over its edge and beyond it."""

from pydantic import Field

from ltm_core.base.strict_model import Expert, StrictModel


class PossibleGround(StrictModel):
    """Bounds of unknown ground that decide whether a ray beyond known ground continues or is unknown.

    Unknown ground rises from known ground no more steeply than `steepest`, and outside of what known ground surrounds
    no higher than `highest`, or where that is not stated, than `margin` above the highest ground of the DEM. A ray
    above it all goes on, and is sky once nothing lies ahead; one that comes down to it is unknown."""

    steepest: Expert[float] = Field(1.5, gt=0)
    """Maximum slope of unknown ground in metres per metre."""
    highest: float | None = None
    """Maximum height of ground for tens of kilometres beyond the DEM, in metres in its vertical datum."""
    margin: Expert[float] = Field(100.0, ge=0)
    """Metres above the DEM's highest ground that are assumed if `highest` is not given."""

    def limit(self, top: float) -> float:
        """Return the height in metres above which there is no ground outside a DEM with the maximum `top`."""
        return top + self.margin if self.highest is None else self.highest


NOTHING_BEYOND = PossibleGround(highest=-1e4)
"""No ground beyond the DEM, as in a rendered scene: rays that leave it upwards are sky."""
