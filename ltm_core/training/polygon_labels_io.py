"""Reads areas that a person named in photos: `polygons.json`, a list of image, class and polygon in pixels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import cv2
import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from ltm_core.errors import RecordingError
from ltm_core.strict_model import StrictModel
from ltm_core.text_io import LARGEST_TABLE, read_text
from ltm_core.types import UInt8Array
from ltm_core.vision.labels import UNLABELLED, LabelSet

POLYGONS_FILE: Final = "polygons.json"

_Coordinate = Annotated[float, Field(ge=-1e5, le=1e5)]


class NamedArea(StrictModel):
    """An area of one class. `image`: the photo's file name; `polygon`: its corners (u, v), pixels of that photo."""

    image: str = Field(pattern=r"^[^/\\\x00]+$")
    label: str = Field(alias="class")
    polygon: tuple[tuple[_Coordinate, _Coordinate], ...] = Field(min_length=3)


_AREAS = TypeAdapter(list[NamedArea])


def read_polygons(path: Path, labels: LabelSet) -> dict[str, list[NamedArea]]:
    """The areas of each photo, in the order of the file. Raises RecordingError: another content, an unknown class."""
    try:
        areas = _AREAS.validate_json(read_text(path, LARGEST_TABLE, RecordingError))
    except ValidationError as error:
        found = "; ".join(f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()[:3])
        raise RecordingError(
            f"{path}: no list of areas ({found}); each has image, class and polygon [[u, v], ...]"
        ) from error
    named: dict[str, list[NamedArea]] = {}
    for place, area in enumerate(areas):
        if area.label != "unlabelled" and area.label not in labels.names:
            known = ", ".join((*labels.names, "unlabelled"))
            raise RecordingError(f"{path}: area {place} is of class {area.label!r}; classes: {known}")
        named.setdefault(area.image, []).append(area)
    return named


def drawn(areas: Sequence[NamedArea], labels: LabelSet, size: tuple[int, int]) -> UInt8Array:
    """Label image (H, W) uint8 of areas, a later one over an earlier one; 255 where none lies."""
    image = np.full(size, UNLABELLED, np.uint8)
    for area in areas:
        corners = np.rint(np.asarray(area.polygon)).astype(np.int32)
        cv2.fillPoly(image, [corners], int(labels.id_of(area.label)))
    return image
