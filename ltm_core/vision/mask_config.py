"""How a site file says which pixels of a camera never show the landscape: a PNG or polygons, of all views or of one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Discriminator, Field, Tag

from ltm_core.plausibility import AzimuthDeg, PitchDeg
from ltm_core.strict_model import StrictModel

MOST_POLYGONS = 200
MOST_VIEW_MASKS = 64
"""Of one camera."""
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


class ViewMask(StrictModel):
    """What hides the landscape where a turning camera looks one way: a preset of its patrol, say."""

    name: str = Field(min_length=1, max_length=80)
    azimuth_deg: AzimuthDeg
    """Of the optical axis, as the pose has it: clockwise from grid north."""
    pitch_deg: PitchDeg
    hfov_deg: float | None = Field(None, gt=0, lt=180)
    """How wide the lens is in this view, to 3 %; None: it does not zoom."""
    within_deg: float = Field(0.5, gt=0, le=10)
    """By which the axis of a picture may be off for the mask to be that picture's."""
    mask: MaskConfig
