"""Draw depth, labels, masks and skylines over a photo, and put pictures on a sheet."""

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, Int16Array, RgbImage, UInt8Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.legend import (
    INK,
    PAPER,
    UNLABELLED,
    ClassPalette,
    Color,
    RangeScale,
    Text,
    depth_colors,
    draw_texts,
    one_two_five,
    text_width,
)


def label_colors(labels: UInt8Array, label_set: ClassPalette, unlabelled: Color = (70, 70, 74)) -> RgbImage:
    """Return the colours (..., 3) of class ids (...) uint8; ids without a colour are `unlabelled`."""
    table = np.tile(np.array(unlabelled, np.uint8), (256, 1))
    table[: len(label_set.colors)] = label_set.colors
    table[UNLABELLED] = unlabelled
    return table.take(np.asarray(labels, np.uint8), axis=0)


def overlay_depth(
    image: RgbImage, ranges: ArrayLike, scale: RangeScale | None = None, opacity: float = 0.55
) -> RgbImage:
    """Return the range colours over the photo (H, W, 3), plain where the range is sky or unknown. `ranges`: (H, W)
    metres, or every n-th pixel. Thin dark lines mark round ranges. Raises ImageError on sizes that disagree."""
    scale = scale or RangeScale()
    values = _to_image_size(np.asarray(ranges, np.float32), image)
    known = np.isfinite(values)
    mixed = _mix(image, depth_colors(values, scale), opacity)
    beyond = np.where(known, values, np.float32(np.inf))
    passed = np.zeros(values.shape, np.int16)
    for tick in scale.ticks():
        passed += beyond >= tick
    line = _edges(passed) & known
    mixed[line] = (mixed[line] * 0.45).astype(np.uint8)
    return where_known(known, mixed, image)


def overlay_labels(image: RgbImage, labels: UInt8Array, label_set: ClassPalette, opacity: float = 0.5) -> RgbImage:
    """Return the class colours over the photo. `labels`: (H, W) uint8, or every n-th pixel. Raises ImageError."""
    ids = _to_image_size(np.asarray(labels, np.uint8), image)
    colors = label_colors(ids, label_set)
    mixed = _mix(image, colors, opacity)
    edge = _edges(ids.astype(np.int16))
    mixed[edge] = (colors[edge] * 0.8).astype(np.uint8)
    return where_known(ids != UNLABELLED, mixed, image)


def where_known(known: BoolArray, image: RgbImage, other: RgbImage) -> RgbImage:
    """Return `image` where `known` (H, W), and `other` elsewhere. OpenCV copies pixels far faster than NumPy."""
    return np.asarray(cv2.copyTo(image, known.view(np.uint8), other.copy()), np.uint8)


def _mix(image: RgbImage, colors: RgbImage, opacity: float) -> RgbImage:
    """Return the colours over the photo's brightness alone; its hues would shift them away from the legend."""
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
    shape = image.shape[:2]
    step = -(-shape[0] // len(values))
    if values.shape != tuple(-(-size // step) for size in shape):
        sizes = f"{values.shape[1]} x {values.shape[0]}", f"{shape[1]} x {shape[0]}"
        raise ImageError(f"a layer of {sizes[0]} pixels does not have every n-th pixel of an image of {sizes[1]}")
    if step == 1:
        return values
    row, col = ((np.arange(size) + step // 2) // step for size in shape)
    return np.asarray(values[np.minimum(row, len(values) - 1)[:, None], np.minimum(col, values.shape[1] - 1)])


COLORS = (
    *((230, 60, 60), (50, 140, 235), (250, 185, 40), (60, 175, 90), (170, 90, 215), (235, 110, 175)),
    *((40, 185, 190), (150, 115, 60)),
)


def mask_picture(photo: RgbImage, proposals: Sequence[BoolArray], kept: Sequence[bool]) -> RgbImage:
    """Return (H, W, 3): `proposals` (H, W) in colours, numbered from 1; those not `kept` as outlines."""
    drawn = photo.copy()
    texts: list[Text] = []
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
        u, v = (np.clip(at, size, most - size) for at, most in ((u, photo.shape[1]), (v, photo.shape[0])))
        texts.append((str(number), float(u), float(v), "mm"))
    return draw_texts(drawn, texts, size, (255, 255, 255), halo=(20, 20, 20))


def with_axes(picture: RgbImage, view: GridGeometry, offset: tuple[float, float] = (0.0, 0.0)) -> RgbImage:
    """Return `picture` (of the raster `view`) with round eastings and northings, metres, plus `offset`."""
    height, width = picture.shape[:2]
    size = max(14, round(width / 54))
    side = min(width, height) * view.resolution
    step = max(step for step in one_two_five(side / 100, side) if step * 3 <= side)
    eastings = _ticks(view.x_min + offset[0], view.x_max + offset[0], step)
    northings = _ticks(view.y_min + offset[1], view.y_max + offset[1], step)
    left = max(text_width(_number(n), size) for n in (*northings, 0.0)) + size
    bottom = round(size * 2.1)
    sheet = np.full((height + bottom, width + left, 3), PAPER, np.uint8)
    sheet[:height, left:] = picture
    cv2.rectangle(sheet, (left, 0), (left + width - 1, height - 1), INK, 1)
    texts: list[Text] = [("m N", left - size * 0.5, height + size * 0.5, "rt")]
    for value in eastings:
        x = left + round((value - offset[0] - view.x_min) / view.resolution)
        cv2.line(sheet, (x, height), (x, height + size // 3), INK, 1)
        name = _number(value) + " m E" * (value == eastings[-1])
        half = text_width(name, size) / 2
        texts.append((name, min(max(x, left + half), left + width - half), height + size * 0.5, "mt"))
    for value in northings:
        y = round((view.y_max - value + offset[1]) / view.resolution)
        cv2.line(sheet, (left - size // 3, y), (left, y), INK, 1)
        texts.append((_number(value), left - size * 0.5, min(max(y, size * 0.6), height - size * 0.6), "rm"))
    return draw_texts(sheet, texts, size, INK)


def _ticks(low: float, high: float, step: float) -> list[float]:
    return [n * step for n in range(math.ceil(low / step), math.floor(high / step) + 1)]


def _number(value: float) -> str:
    return f"{value:.0f}" if value == round(value) else f"{value:g}"


def fit(picture: RgbImage, width: int) -> RgbImage:
    """Return `picture` at `width` pixels, its proportions kept."""
    if width == picture.shape[1]:
        return picture
    height = max(1, round(picture.shape[0] * width / picture.shape[1]))
    method = cv2.INTER_AREA if width < picture.shape[1] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(picture, (width, height), interpolation=method), np.uint8)


def panel(pictures: Sequence[tuple[str, RgbImage]], columns: int = 2, width: int = 800, heading: str = "") -> RgbImage:
    """Return a sheet of titled pictures, row by row, each `width` pixels wide, under its heading."""
    if not pictures or columns < 1:
        raise ImageError(f"a panel needs at least one image and one column, got {len(pictures)} and {columns}")
    size, gap = max(14, round(width / 46)), 14
    title = round(size * 1.8)
    columns = min(columns, len(pictures))
    whole = gap + columns * (width + gap)
    lines = _wrapped(heading, size, whole - 2 * gap)
    fitted = [(name, fit(picture, width)) for name, picture in pictures]
    rows = [fitted[i : i + columns] for i in range(0, len(fitted), columns)]
    heights = [title + max(p.shape[0] for _, p in row) for row in rows]
    y = gap + len(lines) * title
    sheet = np.full((y + sum(h + gap for h in heights), whole, 3), PAPER, np.uint8)
    texts: list[Text] = [(line, gap, gap + (n + 0.5) * title, "lm") for n, line in enumerate(lines)]
    for row, height in zip(rows, heights, strict=True):
        for column, (name, picture) in enumerate(row):
            x = gap + column * (width + gap)
            sheet[y + title : y + title + picture.shape[0], x : x + width] = picture
            texts.append((name, x, y + title * 0.45, "lm"))
        y += height + gap
    return draw_texts(sheet, texts, size, INK)


def _wrapped(text: str, size: float, width: float) -> list[str]:
    """Return the lines of a text that fit a width in pixels."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and text_width(longer, size) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines
