"""Truth from areas that a person named in photos (`polygons_io`), as label images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from ltm_core.errors import RecordingError
from ltm_core.types import UInt8Array
from ltm_core.vision.labels import UNLABELLED, LabelSet
from ltm_core.vision.polygons_io import NamedArea, read_areas

POLYGONS_FILE: Final = "polygons.json"
_NO_CLASS: Final = ("unlabelled", "lens", "caption", "structure")
"""Areas that take truth away: nothing is known there, or `ltm mask` hides it."""


def read_polygons(path: Path, labels: LabelSet) -> dict[str, list[NamedArea]]:
    """The areas of each photo, in the order of the file.

    Raises ConfigError as `read_areas`; RecordingError for an unknown class, and a photo that is in another folder.
    """
    named: dict[str, list[NamedArea]] = {}
    for place, area in enumerate(read_areas(path)):
        if area.kind not in labels.names and area.kind not in _NO_CLASS:
            known = ", ".join((*labels.names, *_NO_CLASS))
            raise RecordingError(f"{path}: area {place} is of class {area.kind!r}; classes: {known}")
        if Path(area.image).name != area.image or not area.image.isprintable():
            raise RecordingError(
                f"{path}: area {place}: image is {area.image!r}, expected the name of a file beside it"
            )
        named.setdefault(area.image, []).append(area)
    return named


def drawn(areas: Sequence[NamedArea], labels: LabelSet, size: tuple[int, int]) -> UInt8Array:
    """Label image (H, W) uint8 of areas, a later one over an earlier one; 255 where none lies."""
    image = np.full(size, UNLABELLED, np.uint8)
    for area in areas:
        label = UNLABELLED if area.kind in _NO_CLASS else labels.id_of(area.kind)
        corners = np.rint(np.clip(np.asarray(area.polygon, np.float64), -1e5, 1e5)).astype(np.int32)
        cv2.fillPoly(image, [corners], int(label))
    return image
