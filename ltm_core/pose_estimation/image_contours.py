"""Edges of a photo by their direction: where the picture changes across a line much more than along it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ltm_core.types import BoolArray, Float32Array, UInt8Array
from ltm_core.vision.cie_lab import cie_lab

ORIENTATIONS = 8


@dataclass(frozen=True, eq=False)
class ImageContours:
    """`response`: (ORIENTATIONS, h, w) float32, of an edge whose normal stands at k 180/ORIENTATIONS degrees from the
    image's u axis towards v, in units of the change that is usual around. `scale`: of its pixels, to the photo's."""

    response: Float32Array
    scale: float


def image_contours(photo: UInt8Array, width: int, hidden: BoolArray | None = None) -> ImageContours:
    """Edges of a photo (H, W, 3) at a width of so many pixels; `hidden` (H, W): what has no edges, clouds and masks.

    The gradient over its local root mean square; of it, what stands across the line, less 0.7 of what runs along it.
    """
    full_height, full_width = photo.shape[:2]
    size = (width, max(2, round(full_height * width / full_width)))
    small = cv2.resize(photo, size, interpolation=cv2.INTER_AREA) if full_width > width else photo
    lab = cie_lab(np.asarray(cv2.GaussianBlur(small, (0, 0), 1.0), np.uint8))
    # Of the three channels' gradients, that which is strongest.
    gu = np.stack([cv2.Scharr(lab[..., c], cv2.CV_32F, 1, 0) for c in range(3)])
    gv = np.stack([cv2.Scharr(lab[..., c], cv2.CV_32F, 0, 1) for c in range(3)])
    strongest = np.argmax(gu * gu + gv * gv, axis=0)[None]
    gu, gv = np.take_along_axis(gu, strongest, 0)[0], np.take_along_axis(gv, strongest, 0)[0]
    if hidden is not None:
        shut = cv2.resize(hidden.astype(np.uint8), (gu.shape[1], gu.shape[0]), interpolation=cv2.INTER_NEAREST)
        shut = cv2.dilate(shut, np.ones((5, 5), np.uint8)) > 0
        gu[shut], gv[shut] = 0.0, 0.0
    window = max(5, gu.shape[1] // 16) | 1
    power = cv2.boxFilter(gu * gu + gv * gv, cv2.CV_32F, (window, window), borderType=cv2.BORDER_REFLECT)
    usual = np.sqrt(power) + np.float32(1e-3) + np.float32(0.15) * np.float32(np.sqrt(power.mean()))
    gu, gv = gu / usual, gv / usual
    response = np.empty((ORIENTATIONS, *gu.shape), np.float32)
    for k in range(ORIENTATIONS):
        angle = np.pi * k / ORIENTATIONS
        c, s = np.float32(np.cos(angle)), np.float32(np.sin(angle))
        across, along = np.abs(gu * c + gv * s), np.abs(gv * c - gu * s)
        np.maximum(across - np.float32(0.7) * along, 0.0, out=response[k])
    return ImageContours(np.minimum(response, np.float32(4.0)), full_width / gu.shape[1])
