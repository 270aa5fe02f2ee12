"""Draw depth, labels, masks and skylines over a photo."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, Int16Array, RgbImage, UInt8Array
from ltm_core.pictures.legend import (
    UNLABELLED,
    ClassPalette,
    RangeScale,
    depth_colors,
    draw_texts,
)


def label_colors(
    labels: UInt8Array, label_set: ClassPalette, unlabelled: tuple[int, int, int] = (70, 70, 74)
) -> RgbImage:
    """Return the colours (..., 3) of class ids (...) uint8; ids without a colour (255 and any not in the set) are
    `unlabelled`."""
    table = np.empty((256, 3), np.uint8)
    table[:] = unlabelled
    colors = np.asarray(label_set.colors, np.uint8)
    table[: len(colors)] = colors
    table[UNLABELLED] = unlabelled
    return table[np.asarray(labels, np.uint8)]


def overlay_depth(
    image: RgbImage, ranges: ArrayLike, scale: RangeScale | None = None, opacity: float = 0.55
) -> RgbImage:
    """Return the range colours over the photo (H, W, 3), plain where the range is sky or unknown. `ranges`: (H, W)
    metres, or every n-th pixel. Thin dark lines mark the scale's round ranges. Raises ImageError on sizes
    that disagree."""
    scale = scale or RangeScale()
    values = _to_image_size(np.asarray(ranges, np.float32), image)
    known = np.isfinite(values)
    mixed = _mix(image, depth_colors(values, scale), opacity)
    line = _edges(np.digitize(np.where(known, values, np.inf), scale.ticks()).astype(np.int16)) & known
    mixed[line] = (mixed[line] * 0.45).astype(np.uint8)
    return np.where(known[..., None], mixed, image)


def overlay_labels(image: RgbImage, labels: UInt8Array, label_set: ClassPalette, opacity: float = 0.5) -> RgbImage:
    """Return the class colours over the photo with thin borders, plain where unlabelled. `labels`: (H, W) uint8, or
    every n-th pixel. Raises ImageError on sizes that disagree."""
    ids = _to_image_size(np.asarray(labels, np.uint8), image)
    colors = label_colors(ids, label_set)
    mixed = _mix(image, colors, opacity)
    edge = _edges(ids.astype(np.int16))
    mixed[edge] = (colors[edge] * 0.8).astype(np.uint8)
    return np.where((ids != UNLABELLED)[..., None], mixed, image)


def _mix(image: RgbImage, colors: RgbImage, opacity: float) -> RgbImage:
    """Return the colours over the photo's brightness alone: the photo's own hues would shift them away from the
    legend."""
    grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    return np.asarray(cv2.addWeighted(grey, 1 - opacity, colors, opacity, 0.0), np.uint8)


def _edges(ids: Int16Array) -> BoolArray:
    """Return the pixels whose right or lower neighbour differs."""
    edge = np.zeros(ids.shape, np.bool_)
    edge[:, :-1] |= ids[:, :-1] != ids[:, 1:]
    edge[:-1] |= ids[:-1] != ids[1:]
    return edge


def _to_image_size(values: NDArray[Any], image: RgbImage) -> NDArray[Any]:
    """`values`, sampled at every n-th pixel of `image` (`values = full[::n, ::n]`), enlarged to nearest."""
    (height, width), (rows, cols) = image.shape[:2], values.shape
    if (rows, cols) == (height, width):
        return values
    step = -(-height // rows)
    if (-(-height // step), -(-width // step)) != (rows, cols):
        raise ImageError(
            f"a layer of {cols} x {rows} pixels does not lie on an image of {width} x {height}: "
            f"it must have every n-th pixel of it"
        )
    row = np.minimum((np.arange(height) + step // 2) // step, rows - 1)
    col = np.minimum((np.arange(width) + step // 2) // step, cols - 1)
    return np.asarray(values[row[:, None], col])


COLORS = (
    *((230, 60, 60), (50, 140, 235), (250, 185, 40), (60, 175, 90), (170, 90, 215), (235, 110, 175)),
    *((40, 185, 190), (150, 115, 60)),
)


def mask_picture(photo: RgbImage, proposals: Sequence[BoolArray], kept: Sequence[bool]) -> RgbImage:
    """Return (H, W, 3): each of `proposals` (H, W) in a colour with its number from 1 on; those not `kept` as
    outlines."""
    drawn = photo.copy()
    texts: list[tuple[str, float, float, str]] = []
    size = max(14.0, photo.shape[1] / 45)
    for number, (hidden, keep) in enumerate(zip(proposals, kept, strict=True), start=1):
        color = np.array(COLORS[(number - 1) % len(COLORS)], np.float32)
        if keep:
            drawn[hidden] = (0.45 * drawn[hidden] + 0.55 * color).astype(np.uint8)
        outlines, _ = cv2.findContours(hidden.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(drawn, outlines, -1, color.tolist(), max(2, photo.shape[1] // 500))
        # The number is in the thickest place, clear of the picture's edge.
        depth = cv2.distanceTransform(np.pad(hidden.astype(np.uint8), 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
        v, u = np.unravel_index(int(np.argmax(depth)), depth.shape)
        u_text = float(np.clip(u, size, photo.shape[1] - size))
        texts.append((str(number), u_text, float(np.clip(v, size, photo.shape[0] - size)), "mm"))
    return draw_texts(drawn, texts, size, (255, 255, 255), halo=(20, 20, 20))  # type: ignore[arg-type]
