"""Small pictures for the status page: a camera's photo, its labels and depth over it, and the site's map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.camera import Camera
from ltm_core.grid import GridGeometry
from ltm_core.pictures.class_palette import UNLABELLED, ClassPalette
from ltm_core.pictures.encode import to_jpeg, to_png
from ltm_core.pictures.maps import MapCamera, furnished, interesting_bounds, nearest, view_of
from ltm_core.pictures.overlay import label_colors, overlay_depth, overlay_labels
from ltm_core.pose import Pose
from ltm_core.types import Float32Array, RgbImage, UInt8Array

WIDTH = 800
"""Of a picture at most, pixels."""
REACH = 3000.0
"""Of a camera's sector on the map, metres."""


@dataclass(frozen=True, eq=False)
class CameraPicture:
    """One frame with what was made of it: `photo` (H, W, 3), `labels` (H, W), `depth` (H, W) metres."""

    name: str
    stamp_ns: int
    photo: RgbImage
    labels: UInt8Array
    depth: Float32Array
    camera: Camera
    pose: Pose

    def small(self) -> CameraPicture:
        """Every n-th pixel of all, so that they stay in place, and at most `WIDTH` wide; copies."""
        step = max(1, -(-self.photo.shape[1] // WIDTH))

        def thin(values: NDArray[Any]) -> NDArray[Any]:
            return values[::step, ::step].copy()

        return CameraPicture(
            self.name, self.stamp_ns, thin(self.photo), thin(self.labels), thin(self.depth), self.camera, self.pose
        )

    def pixel(self, across: float, down: float) -> tuple[float, float]:
        """(u, v) of the camera's own picture, where `across` and `down` are shares of this one's width and height."""
        rows, columns = self.photo.shape[:2]
        step = -(-self.camera.width // columns)
        u, v = (across * columns - 0.5) * step, (down * rows - 0.5) * step
        return min(max(u, 0.0), self.camera.width - 1.0), min(max(v, 0.0), self.camera.height - 1.0)

    def jpeg(self, kind: str, palette: ClassPalette) -> bytes:
        """`kind`: photo, labels or depth. Raises ImageError where sizes disagree."""
        if kind == "labels":
            return to_jpeg(overlay_labels(self.photo, self.labels, palette))
        if kind == "depth":
            return to_jpeg(overlay_depth(self.photo, self.depth))
        return to_jpeg(self.photo)

    @property
    def on_map(self) -> MapCamera:
        x, y, _ = self.pose.position
        return MapCamera(self.name, self.camera, (float(x), float(y)), self.pose.angles_deg[0], REACH)


def map_png(classes: UInt8Array, geometry: GridGeometry, palette: ClassPalette, cameras: Sequence[MapCamera]) -> bytes:
    """The part of the life form map that is known, with the cameras; `classes` (H, W), 255 unknown, north up."""
    bounds = interesting_bounds(classes != UNLABELLED, geometry, cameras, geometry)
    view = view_of(bounds, WIDTH)
    ids = nearest(classes, geometry, view, UNLABELLED)
    picture = label_colors(ids, palette, unlabelled=(205, 208, 212))
    lines = np.zeros(ids.shape, np.bool_)
    lines[:, 1:] |= ids[:, 1:] != ids[:, :-1]
    lines[1:] |= ids[1:] != ids[:-1]
    picture[lines] = (picture[lines] * 0.85).astype(np.uint8)
    return to_png(np.asarray(cv2.GaussianBlur(furnished(picture, view, cameras, None), (0, 0), 0.4), np.uint8))
