"""How high the ground may be where a DEM does not know it: in its holes, over its edge and beyond its end."""

from __future__ import annotations

from pydantic import Field

from ltm_core.strict_model import StrictModel


class PossibleGround(StrictModel):
    """Bounds of unknown ground, by which a ray that has been over known ground goes on, or is unknown.

    Unknown ground rises from known ground no more steeply than `steepest`, and outside of what known ground surrounds
    no higher than `highest`, or where that is not stated, than `margin` above the highest ground of the DEM. A ray
    above it all goes on, and is sky once nothing lies ahead; one that comes down to it is unknown.
    """

    steepest: float = Field(1.5, gt=0)
    """Metres a metre."""
    highest: float | None = None
    """Metres in the DEM's vertical datum: no ground for tens of kilometres beyond the DEM is higher."""
    margin: float = Field(100.0, ge=0)
    """Metres above the DEM's highest ground, where `highest` is not stated."""

    def limit(self, top: float) -> float:
        """Metres above which there is no ground outside a DEM whose highest is `top`."""
        return top + self.margin if self.highest is None else self.highest


NOTHING_BEYOND = PossibleGround(highest=-1e4)
"""The world ends with the DEM, as that of a rendered scene does: what climbs out of it is sky."""
