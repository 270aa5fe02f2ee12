"""The picture by which a person confirms what a mask shall hide: the photo, each proposal coloured and numbered."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ltm_core.pictures.text import draw_texts
from ltm_core.types import BoolArray, RgbImage

COLORS = (
    *((230, 60, 60), (50, 140, 235), (250, 185, 40), (60, 175, 90), (170, 90, 215), (235, 110, 175)),
    *((40, 185, 190), (150, 115, 60)),
)


def mask_picture(photo: RgbImage, proposals: Sequence[BoolArray], kept: Sequence[bool]) -> RgbImage:
    """(H, W, 3): each of `proposals` (H, W) in a colour with its number from 1 on; those not `kept` as outlines."""
    drawn = photo.copy()
    texts: list[tuple[str, float, float, str]] = []
    size = max(14.0, photo.shape[1] / 45)
    for number, (hidden, keep) in enumerate(zip(proposals, kept, strict=True), start=1):
        color = np.array(COLORS[(number - 1) % len(COLORS)], np.float32)
        if keep:
            drawn[hidden] = (0.45 * drawn[hidden] + 0.55 * color).astype(np.uint8)
        outlines, _ = cv2.findContours(hidden.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(drawn, outlines, -1, color.tolist(), max(2, photo.shape[1] // 500))
        # The number stands in the thickest place, clear of the picture's edge.
        depth = cv2.distanceTransform(np.pad(hidden.astype(np.uint8), 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
        v, u = np.unravel_index(int(np.argmax(depth)), depth.shape)
        u_text = float(np.clip(u, size, photo.shape[1] - size))
        texts.append((str(number), u_text, float(np.clip(v, size, photo.shape[0] - size)), "mm"))
    return draw_texts(drawn, texts, size, (255, 255, 255), halo=(20, 20, 20))  # type: ignore[arg-type]
