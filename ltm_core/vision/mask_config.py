"""How a site file says which pixels of a fixed camera never show the landscape: a PNG, or polygons."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Discriminator, Field, Tag

from ltm_core.strict_model import StrictModel

MOST_POLYGONS = 200
MOST_POINTS = 2000
"""Of one polygon."""

Point = tuple[Annotated[float, Field(ge=-1e5, le=1e5)], Annotated[float, Field(ge=-1e5, le=1e5)]]


class MaskPolygon(StrictModel):
    """One area that hides the landscape."""

    model_config = ConfigDict(
        extra="forbid", frozen=True, protected_namespaces=(), allow_inf_nan=False, populate_by_name=True
    )

    kind: str = Field("", alias="class", max_length=80)
    """What it is: mast, lens, caption, roof."""
    reason: str = Field("", max_length=400)
    """Why it is masked, in words."""
    polygon: tuple[Point, ...] = Field(min_length=3, max_length=MOST_POINTS)
    """Corners (u, v) in pixels, (0, 0) the centre of the top left pixel."""


def _written_as(value: object) -> str:
    return "polygons" if isinstance(value, list | tuple) else "png"


MaskConfig = Annotated[
    Annotated[Path, Tag("png")]
    | Annotated[tuple[MaskPolygon, ...], Field(min_length=1, max_length=MOST_POLYGONS), Tag("polygons")],
    Discriminator(_written_as),
]
"""A PNG of one channel and of the picture's size beside the site file, in which all but 0 is masked; or polygons."""
