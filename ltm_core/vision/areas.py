"""Read, write and rasterise named areas of photos, and outline regions as polygons.

Later areas lie over earlier ones. A region with a hole becomes several polygons."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from ltm_core.base.errors import ConfigError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.storage.config_io import checked, read_text
from ltm_core.vision.labels import UNLABELLED, LabelSet
from ltm_core.vision.mask_config import MOST_POINTS, Point
from ltm_core.vision.masks import fill

POLYGONS_FILE: Final = "polygons.json"
MASKED: Final = "masked"  # class of areas that hide the landscape, for `ltm mask --drawn`; unlabelled in label images
ERASED: Final = "unlabelled"  # class of areas in which earlier areas are erased
LARGEST_FILE = 16 << 20  # maximum bytes of a file
MOST_AREAS = 20_000


class NamedArea(StrictModel):
    """One area of one photo."""

    model_config = ConfigDict(populate_by_name=True)

    image: str = Field(max_length=255)
    """File name of the photo."""
    kind: str = Field(alias="class", max_length=80)
    """Class of the label set, `MASKED`, `ERASED`, or the kind of a mask: bar, lens, caption."""
    polygon: tuple[Point, ...] = Field(min_length=3, max_length=MOST_POINTS)
    """Corners (u, v) in pixels of the photo."""
    number: int | None = None
    """Number of the area's proposal by `ltm mask`."""
    reason: str = Field("", max_length=400)


class _NamedAreas(StrictModel):
    areas: tuple[NamedArea, ...] = Field(max_length=MOST_AREAS)


def parse_areas(text: str, place: str) -> tuple[NamedArea, ...]:
    """Parse areas. Raises ConfigError for invalid JSON, another form or invalid areas; `place` names the text."""
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{place}: not JSON ({error})") from error
    if not isinstance(content, list):
        raise ConfigError(f"{place}: expected a list of areas (image, class, polygon), got {type(content).__name__}")
    return checked(_NamedAreas, {"areas": content}, place, unnamed=("areas",)).areas


def read_areas(path: Path) -> tuple[NamedArea, ...]:
    """Read areas. Raises ConfigError as `parse_areas`, and if the file cannot be read."""
    return parse_areas(read_text(path, LARGEST_FILE, ConfigError), str(path))


def write_areas(path: Path, areas: Sequence[NamedArea]) -> None:
    """Write one line per area, atomically."""
    content = (area.model_dump(by_alias=True, exclude_defaults=True, mode="json") for area in areas)
    lines = [json.dumps(area, ensure_ascii=False) for area in content]
    replace_file(path, ("[\n" + ",\n".join(lines) + "\n]\n").encode())


def replace_file(path: Path, content: bytes) -> None:
    """Write a file whole, or leave what was there. Raises OSError."""
    beside = path.with_name(f".{path.name}.part")
    beside.write_bytes(content)
    beside.replace(path)


Outline = tuple[tuple[float, float], ...]
Points = Sequence[Sequence[float]]


def labels_of(areas: Sequence[NamedArea], height: int, width: int, labels: LabelSet) -> UInt8Array:
    """Return (H, W) class ids; 255 in unlabelled areas and for other classes."""
    drawn = np.full((height, width), UNLABELLED, np.uint8)
    for area in areas:
        value = labels.names.index(area.kind) if area.kind in labels.names else int(UNLABELLED)
        fill(drawn, area.polygon, value)
    return drawn


def stroke_areas(image: str, kind: str, points: Points, radius: float, height: int, width: int) -> list[NamedArea]:
    """Return the areas covered by a round brush of this radius (pixels) along `points` (u, v) of a photo."""
    drawn = np.zeros((height, width), np.uint8)
    path = np.rint(np.array(points, np.float64)).astype(np.int32)
    thick = max(1, round(2 * radius))
    cv2.polylines(drawn, [path.reshape(-1, 1, 2)], False, [1], thick)
    for u, v in path.tolist():
        cv2.circle(drawn, (u, v), max(0, round(radius)), [1], -1)
    return [NamedArea(image=image, kind=kind, polygon=outline) for outline in polygons_of(drawn > 0, 0.5)]


def areas_of(image: str, labels: UInt8Array, names: Sequence[str], least: float = 0.0003) -> list[NamedArea]:
    """Return the areas of a label image (H, W), largest first, so that inner areas are drawn over outer ones. `least`:
    share of the image; smaller regions are left out."""
    found: list[tuple[float, NamedArea]] = []
    for index, name in enumerate(names):
        smooth = cv2.medianBlur((labels == index).astype(np.uint8), 5) > 0
        for outline in polygons_of(np.asarray(smooth, np.bool_), 1.5, filled=True):
            size = cv2.contourArea(np.array(outline, np.float32))
            if size >= least * labels.size:
                found.append((size, NamedArea(image=image, kind=name, polygon=outline)))
    return [area for _, area in sorted(found, key=lambda one: -one[0])]


def polygons_of(region: BoolArray, tolerance: float = 1.0, filled: bool = False, left: int = 0) -> list[Outline]:
    """Return outlines (u, v) of the parts of (H, W), to `tolerance` pixels, coarser where a polygon would have too many
    corners (`MOST_POINTS`). `filled`: holes are filled; otherwise a region with holes is cut in two until no part has
    one. `left`: first column of the region."""
    mode = cv2.RETR_EXTERNAL if filled else cv2.RETR_CCOMP
    contours, tree = cv2.findContours(region.astype(np.uint8), mode, cv2.CHAIN_APPROX_SIMPLE, offset=(left, 0))
    if tree is not None and (tree[0, :, 3] >= 0).any():
        middle = region.shape[1] // 2
        halves = polygons_of(region[:, :middle], tolerance, left=left)
        return sorted(halves + polygons_of(region[:, middle:], tolerance, left=left + middle))
    return sorted(_few_corners(np.asarray(contour, np.int32), tolerance) for contour in contours)


def _few_corners(contour: NDArray[np.int32], tolerance: float) -> Outline:
    """Return as few corners of a contour as the tolerance lets; no more than a polygon may have."""
    while len(corners := cv2.approxPolyDP(contour, tolerance, closed=True)[:, 0]) > MOST_POINTS:
        tolerance *= 2
    # A line or a dot is a polygon too: of three corners, the last of them repeated.
    corners = corners[np.minimum(np.arange(max(3, len(corners))), len(corners) - 1)]
    return tuple((float(u), float(v)) for u, v in corners)
