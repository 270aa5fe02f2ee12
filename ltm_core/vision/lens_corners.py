"""Find image corners covered by a lens hood: smooth, of one colour, bounded by an arc, in all frames.

Of a single frame a dark slope in the corner looks alike, or a piece of sky; over frames in other light the hood alone
keeps its edge. What is found is proposed, and a person confirms it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import BoolArray, Float32Array, Float64Array, UInt8Array
from ltm_core.vision.label_rules import cie_lab

_PATCH = 0.02
"""Side of the square in the corner that gives the hood's colour, as a share of the width."""
_TOLERANCES = np.arange(5.0, 46.0, 2.0)
"""Tolerances of a hood's colour in units of CIE Lab; the one with the sharpest edge is used."""
_REACH = 0.5
"""Maximum width of a corner, as a share of the width."""
_LEAST_AREA, _MOST_AREA = 0.0015, 0.13
"""Minimum and maximum area, as a share of the image."""
_MOST_TEXTURE = 1.6
"""Maximum median local contrast (Lab L) in a hood; land has more, and JPEG noise less."""
_MOST_RESIDUAL = 0.014
"""Maximum mean distance between the edge and the arc, as a share of the width."""
_LEAST_EDGE = 0.9
"""Minimum mean gradient at the edge in units of CIE Lab per pixel at a width of 640; that of a cloud is lower."""
_PENUMBRA = 0.012
"""Width by which a corner is enlarged, as a share of the width, because a hood's edge is out of focus."""


@dataclass(frozen=True, eq=False)
class LensCorner:
    """`hidden`: (H, W). `edge`: mean gradient at its edge, units of CIE Lab a pixel at a width of 640."""

    hidden: BoolArray
    edge: float


def lens_corners(frames: Sequence[UInt8Array]) -> list[LensCorner]:
    """Find lens corners in images (H, W, 3) RGB of one camera, about 640 pixels wide; deterministic."""
    labs = [_lab(frame) for frame in frames]
    found = []
    for up in (True, False):
        for left in (True, False):
            turned = [_to_top_left(lab, up, left) for lab in labs]
            corner = _top_left(turned)
            if corner is not None:
                hidden = np.ascontiguousarray(_to_top_left(corner.hidden, up, left))
                found.append(LensCorner(hidden, corner.edge))
    return found


def _lab(frame: UInt8Array) -> Float32Array:
    return cie_lab(np.asarray(cv2.GaussianBlur(frame, (0, 0), 1.5), np.uint8))


def _to_top_left(values: NDArray[Any], up: bool, left: bool) -> NDArray[Any]:
    """Flipped so that a corner is the top left one; flipped again it is as it was."""
    return values[:: 1 if up else -1, :: 1 if left else -1]


def _top_left(labs: Sequence[Float32Array]) -> LensCorner | None:
    height, width = labs[0].shape[:2]
    side = max(3, round(_PATCH * width))
    away = np.zeros((height, width), np.float32)  # from the hood's colour, mean of the frames
    gradient = np.zeros((height, width), np.float32)
    texture = np.zeros((height, width), np.float32)
    for lab in labs:
        hood = np.median(lab[:side, :side].reshape(-1, 3), axis=0)
        away += np.linalg.norm(lab - hood, axis=2).astype(np.float32) / len(labs)
        across, down = cv2.Sobel(lab, cv2.CV_32F, 1, 0, ksize=3), cv2.Sobel(lab, cv2.CV_32F, 0, 1, ksize=3)
        gradient += np.sqrt((across**2 + down**2).sum(axis=2)) / (8 * len(labs))
        light = np.ascontiguousarray(lab[..., 0])
        texture += np.abs(light - cv2.GaussianBlur(light, (0, 0), 3.0)) / len(labs)
    best: LensCorner | None = None
    for tolerance in _TOLERANCES:
        corner = _within(away < tolerance, gradient, texture)
        if corner is not None and (best is None or corner.edge > best.edge):
            best = corner
    return best


def _within(near: BoolArray, gradient: Float32Array, texture: Float32Array) -> LensCorner | None:
    """Return the region of one colour in the top left corner, if it is one that a hood would have."""
    height, width = near.shape
    # Letters on the hood are closed; thin bridges to the sky are cut.
    size = max(3, round(0.012 * width))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    padded = cv2.copyMakeBorder(near.astype(np.uint8), size, size, size, size, cv2.BORDER_REPLICATE)
    solid = cv2.morphologyEx(cv2.morphologyEx(padded, cv2.MORPH_CLOSE, disc), cv2.MORPH_OPEN, disc)
    solid = solid[size:-size, size:-size]
    _, parts = cv2.connectedComponents(solid, connectivity=4)
    if parts[0, 0] == 0:
        return None
    region = np.asarray(parts == parts[0, 0])
    area = float(region.mean())
    if not _LEAST_AREA < area < _MOST_AREA:
        return None
    rows, cols = np.flatnonzero(region.any(axis=1)), np.flatnonzero(region.any(axis=0))
    if cols[-1] > _REACH * width or rows[-1] > 0.97 * height:
        return None
    if float(np.median(texture[region])) > _MOST_TEXTURE:
        return None
    inner = cv2.erode(region.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) > 0
    edge = region & ~inner
    edge[-1], edge[:, -1] = False, False
    v, u = np.nonzero(edge)
    if len(u) < 10:
        return None
    arc = _arc(np.column_stack([u, v]).astype(np.float64))
    if arc is None:
        return None
    middle, radius, residual = arc
    # The image's middle lies on the inner side of the arc, and it bends about it.
    inside = np.hypot(width / 2 - middle[0], height / 2 - middle[1]) < radius
    if not inside or residual > _MOST_RESIDUAL * width or not 0.25 * width < radius < 3.0 * width:
        return None
    strength = float(gradient[edge].mean())
    if strength < _LEAST_EDGE:
        return None
    all_rows, all_cols = np.mgrid[0:height, 0:width]
    beyond = np.hypot(all_cols - middle[0], all_rows - middle[1]) > radius - _PENUMBRA * width
    window = (all_rows <= rows[-1] + 2 * size) & (all_cols <= cols[-1] + 2 * size)
    return LensCorner(beyond & window, strength)


def _arc(points: Float64Array) -> tuple[Float64Array, float, float] | None:
    """Return the middle (u, v), radius and mean residual of a circle through points (N, 2), by least squares."""
    matrix = np.column_stack([2 * points, np.ones(len(points))])
    solution = np.linalg.lstsq(matrix, (points**2).sum(axis=1), rcond=None)[0]
    square = solution[2] + solution[0] ** 2 + solution[1] ** 2
    if square <= 0:
        return None
    radius = float(np.sqrt(square))
    residual = float(np.abs(np.hypot(*(points - solution[:2]).T) - radius).mean())
    return solution[:2], radius, residual
