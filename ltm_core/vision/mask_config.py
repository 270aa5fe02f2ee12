"""Configure the masks of a camera: a PNG or polygons, for all views or for one."""

from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Discriminator, Field, Tag

from ltm_core.base.strict_model import StrictModel, Written
from ltm_core.cameras.plausibility import AzimuthDeg, PitchDeg

MOST_POLYGONS = 200
MOST_VIEW_MASKS = 64  # maximum number of view masks of one camera
MOST_POINTS = 2000  # maximum number of points of one polygon


Point = tuple[Annotated[float, Field(ge=-1e5, le=1e5)], Annotated[float, Field(ge=-1e5, le=1e5)]]


class MaskPolygon(StrictModel):
    """One area that hides the landscape."""

    model_config = ConfigDict(populate_by_name=True)

    kind: Written[str] = Field("", alias="class", max_length=80)
    """Kind of area: mast, lens, bar, caption, roof."""
    reason: Written[str] = Field("", max_length=400)
    """Reason for the mask, in words."""
    polygon: Written[tuple[Point, ...]] = Field(min_length=3, max_length=MOST_POINTS)
    """Corners (u, v) in pixels, (0, 0) the centre of the top left pixel."""


MaskConfig = Annotated[
    Annotated[Path, Tag("png")]
    | Annotated[tuple[MaskPolygon, ...], Field(min_length=1, max_length=MOST_POLYGONS), Tag("polygons")],
    Discriminator(lambda value: "polygons" if isinstance(value, list | tuple) else "png"),
]
"""Mask as a single-channel PNG of the image's size beside the site file, in which all but 0 is masked, or as polygons.
"""


class ViewMask(StrictModel):
    """Mask for one viewing direction of a turning camera, for example a preset of its patrol."""

    name: str = Field(min_length=1, max_length=80)
    """Name of the view, for example that of its preset."""
    azimuth_deg: AzimuthDeg
    """Azimuth of the optical axis in degrees, clockwise from grid north as in the pose."""
    pitch_deg: PitchDeg
    """Pitch of the optical axis in degrees, up from the horizon."""
    hfov_deg: float | None = Field(None, gt=0, lt=180)
    """Horizontal field of view in degrees in this view, within 3 %; None: the lens does not zoom."""
    within_deg: float = Field(0.5, gt=0, le=10)
    """Maximum angle in degrees between an image's axis and this direction for the mask to apply."""
    mask: MaskConfig
    """Mask of the view: a PNG or polygons, as of a camera."""
