"""How high the ground may be where a DEM does not know it: in its holes, over its edge and beyond its end."""

from __future__ import annotations

from pydantic import Field

from ltm_core.strict_model import StrictModel


class PossibleGround(StrictModel):
    """Bounds of unknown ground, by which a ray that has been over known ground goes on, or is unknown.

    Unknown ground rises from known ground no more steeply than `steepest`, and no higher than `highest` outside of what
    known ground surrounds. A ray above it all goes on, and is sky once nothing lies ahead; one that comes down to it is
    unknown.
    """

    steepest: float = Field(1.5, gt=0)
    """Metres a metre."""
    highest: float | None = None
    """Metres in the DEM's vertical datum; None: the DEM's own highest ground."""


NOTHING_BEYOND = PossibleGround(highest=-1e4)
"""The world ends with the DEM, as that of a rendered scene does: what climbs out of it is sky."""
