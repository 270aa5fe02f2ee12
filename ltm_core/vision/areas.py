"""Read, write and rasterise named areas of photos, and outline regions as polygons.

Later areas lie over earlier ones. The hole of a region becomes part of its outline, by a cut that leads to it."""

import json
from collections.abc import Sequence
from itertools import pairwise
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
MOST_HOLES = 200  # maximum number of holes of one part; smaller ones are filled, so that outlines keep few corners
_Points = NDArray[np.int32]
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


def polygons_of(region: BoolArray, tolerance: float = 1.0, filled: bool = False) -> list[Outline]:
    """Return outlines (u, v) of the parts of (H, W), to `tolerance` pixels, coarser where a polygon would have too many
    corners (`MOST_POINTS`). `filled`: holes are filled. Otherwise the outline goes into each hole and back, for the
    even-odd rule."""
    mode = cv2.RETR_EXTERNAL if filled else cv2.RETR_CCOMP
    # All pixels of the edges: a cut to a hole ends at one of them.
    contours, tree = cv2.findContours(region.astype(np.uint8), mode, cv2.CHAIN_APPROX_NONE)
    parents = [] if tree is None else tree[0, :, 3].tolist()
    found = []
    for number in [number for number, parent in enumerate(parents) if parent < 0]:
        inner = [np.asarray(c, np.int32) for c, parent in zip(contours, parents, strict=True) if parent == number]
        holes = sorted(inner, key=cv2.contourArea)
        small = max(0, len(holes) - MOST_HOLES)
        solid = region
        if small:  # of this part alone: another one that lies in such a hole keeps its own
            drawn = cv2.drawContours(region.astype(np.uint8), holes[:small], -1, [1], cv2.FILLED)
            solid = np.asarray(drawn, np.uint8) > 0
        edges = [np.asarray(edge[:, 0], np.int32) for edge in (contours[number], *holes[small:])]
        points, fixed = _with_cuts(solid, edges[0], edges[1:])
        found.append(_few_corners(points, fixed, tolerance))
    return sorted(found)


def _with_cuts(region: BoolArray, outer: _Points, holes: list[_Points]) -> tuple[_Points, NDArray[np.bool_]]:
    """Return one closed line (N, 2) about a part and its holes, and at which of its points (N,) a cut ends."""
    points, fixed = outer, np.zeros(len(outer), np.bool_)
    # From the left: what lies left of a hole, the outline or another hole, is part of the line already.
    for hole in sorted(holes, key=lambda one: int(one[:, 0].min())):
        start = int(np.argmin(hole[:, 0]))
        u, v = (int(value) for value in hole[start])
        beyond = np.flatnonzero(~region[v, :u])
        left = int(beyond[-1]) + 1 if len(beyond) else 0
        at = int(np.flatnonzero((points == (left, v)).all(axis=1))[0])
        around = np.concatenate([hole[start:], hole[: start + 1]])
        ends = np.zeros(len(around), np.bool_)
        ends[[0, -1]] = True
        points = np.concatenate([points[: at + 1], around, points[at:]])
        fixed = np.concatenate([fixed[:at], [True], ends, [True], fixed[at + 1 :]])
    return points, fixed


def _few_corners(points: _Points, fixed: NDArray[np.bool_], tolerance: float) -> Outline:
    """Of a closed line, as few corners as the tolerance lets, and the `fixed` ones; no more than a polygon may have."""
    while len(corners := _simplified(points, fixed, tolerance)) > MOST_POINTS:
        tolerance *= 2
    # A line or a dot is a polygon too: of three corners, the last of them repeated.
    corners = corners[np.minimum(np.arange(max(3, len(corners))), len(corners) - 1)]
    return tuple((float(u), float(v)) for u, v in corners)


def _simplified(points: _Points, fixed: NDArray[np.bool_], tolerance: float) -> _Points:
    if not fixed.any():
        return np.asarray(cv2.approxPolyDP(points.reshape(-1, 1, 2), tolerance, closed=True)[:, 0], np.int32)
    first = int(np.argmax(fixed))
    line = np.concatenate([points[first:], points[: first + 1]])
    stops = np.flatnonzero(np.concatenate([fixed[first:], fixed[: first + 1]]))
    parts = []
    for a, b in pairwise(stops.tolist()):
        part = line[a : b + 1]
        ends = [0, len(part) - 1]
        if (part[0] == part[-1]).all():  # once around: OpenCV would close it, and begin where it likes
            ends.insert(1, int(np.argmax(((part - part[0]) ** 2).sum(axis=1))))
        for c, d in pairwise(ends):
            parts.append(cv2.approxPolyDP(part[c : d + 1].reshape(-1, 1, 2), tolerance, closed=False)[:-1, 0])
    return np.asarray(np.concatenate(parts), np.int32)
