"""Label images from areas that a person has drawn, in their order: later ones lie over earlier ones."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ltm_core.types import UInt8Array
from ltm_core.vision.camera_mask import fill
from ltm_core.vision.labels import UNLABELLED, LabelSet
from ltm_core.vision.outlines import polygons_of
from ltm_core.vision.polygons_io import NamedArea

Points = Sequence[Sequence[float]]


def labels_of(areas: Sequence[NamedArea], height: int, width: int, labels: LabelSet) -> UInt8Array:
    """(H, W) class ids; 255 where nothing is named, and where the class is none of the label set."""
    drawn = np.full((height, width), UNLABELLED, np.uint8)
    for area in areas:
        value = labels.names.index(area.kind) if area.kind in labels.names else int(UNLABELLED)
        fill(drawn, area.polygon, value)
    return drawn


def stroke_areas(image: str, kind: str, points: Points, radius: float, height: int, width: int) -> list[NamedArea]:
    """What a round brush of this radius (pixels) covers along `points` (u, v) of a photo, as areas."""
    drawn = np.zeros((height, width), np.uint8)
    path = np.rint(np.array(points, np.float64)).astype(np.int32)
    thick = max(1, round(2 * radius))
    cv2.polylines(drawn, [path.reshape(-1, 1, 2)], False, [1], thick)
    for u, v in path.tolist():
        cv2.circle(drawn, (u, v), max(0, round(radius)), [1], -1)
    return [NamedArea(image=image, kind=kind, polygon=outline) for outline in polygons_of(drawn > 0, 0.5)]


def areas_of(image: str, labels: UInt8Array, names: Sequence[str], least: float = 0.0003) -> list[NamedArea]:
    """A label image (H, W) as areas, the largest first, so that what lies within another lies over it.

    `least`: share of the picture; smaller regions are left out.
    """
    found: list[tuple[float, NamedArea]] = []
    for index, name in enumerate(names):
        region = (labels == index).astype(np.uint8)
        if not region.any():
            continue
        smooth = cv2.medianBlur(region * np.uint8(255), 5) > 127
        found += [
            (cv2.contourArea(np.array(outline, np.float32)), NamedArea(image=image, kind=name, polygon=outline))
            for outline in polygons_of(np.asarray(smooth, np.bool_), 1.5, filled=True)
        ]
    kept = [(size, area) for size, area in found if size >= least * labels.size]
    return [area for _, area in sorted(kept, key=lambda one: -one[0])]
