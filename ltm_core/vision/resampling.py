"""Reduce photos for networks, and enlarge class probabilities to labels of the photo's size."""

from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from ltm_core.base.kernels import kernel
from ltm_core.base.types import Float32Array, Int32Array, UInt8Array


def upsampled_winner(probabilities: Float32Array, height: int, width: int) -> tuple[UInt8Array, UInt8Array]:
    """Return the most probable class of each pixel of a `height` x `width` image, interpolated bilinearly.

    `probabilities` is (K, h, w) float32 in 0..1. Both grids cover the same field of view edge to edge (pixel
    centres at half-integers, as in `cv2.resize`). Returns (H, W) uint8 indices into K, the lower one on a tie, and
    (H, W) uint8 probability x 255, rounded. One pass, no (K, H, W) array in between."""
    _, rows, cols = probabilities.shape
    row_below, row_weight = neighbours(rows, height)
    col_right, col_weight = neighbours(cols, width)
    winner = np.empty((height, width), dtype=np.uint8)
    confidence = np.empty((height, width), dtype=np.uint8)
    planes = np.ascontiguousarray(probabilities, dtype=np.float32)
    _interpolate(planes, row_below, row_weight, col_right, col_weight, winner, confidence)
    return winner, confidence


def neighbours(size: int, target: int) -> tuple[Int32Array, Float32Array]:
    """Return the first of the two source samples of each of `target` samples, and the weight of the second."""
    centre = (np.arange(target) + 0.5) * (size / target) - 0.5
    centre = np.clip(centre, 0.0, size - 1.0)
    first = np.minimum(centre.astype(np.int32), max(size - 2, 0)).astype(np.int32)
    return first, (centre - first).astype(np.float32)


def reduced_by_area(photo: UInt8Array, width: int, height: int) -> UInt8Array:
    """Return a photo (H, W, 3) reduced by area as `cv2.resize` does, but for the last rounding, in a quarter of the
    time."""
    if photo.shape[:2] == (2 * height, 2 * width):
        return np.asarray(cv2.resize(photo, (width, height), interpolation=cv2.INTER_AREA), np.uint8)  # quicker here
    small = np.empty((height, width, 3), np.uint8)
    whole = np.ascontiguousarray(photo, np.uint8).reshape(len(photo), -1).view()
    whole.flags.writeable = False  # one compiled kernel for images of messages and of our own
    _reduce(whole, *_shares(photo.shape[0], height), *_shares(photo.shape[1], width), small)
    return small


@lru_cache(maxsize=64)
def _shares(size: int, target: int) -> tuple[Int32Array, Float32Array]:
    """Return the first source pixel (target,) of each target pixel, and the weights (target, n) of it and those after
    it."""
    edges = np.arange(target + 1) * (size / target)
    first = np.floor(edges[:-1]).astype(np.int32)
    count = int((np.ceil(edges[1:]) - first).max())
    first = np.minimum(first, size - count).astype(np.int32)
    at = first[:, None] + np.arange(count)
    overlap = np.minimum(at + 1, edges[1:, None]) - np.maximum(at, edges[:-1, None])
    return first, (np.maximum(overlap, 0.0) * (target / size)).astype(np.float32)


@kernel(nogil=True, fastmath={"contract", "nsz"})
def _reduce(photo: Any, first_row: Any, row_share: Any, first_col: Any, col_share: Any, small: Any) -> None:
    """Reduce `photo` (H, 3 W): its rows first, in a loop that becomes vector code."""
    line = np.empty(photo.shape[1], np.float32)
    for row in range(small.shape[0]):
        line[:] = 0
        for k in range(row_share.shape[1]):
            share = row_share[row, k]
            if share > 0:
                source = photo[first_row[row] + k]
                for at in range(len(line)):
                    line[at] += share * np.float32(source[at])
        for col in range(small.shape[1]):
            red = green = blue = np.float32(0.0)
            at = 3 * first_col[col]
            for k in range(col_share.shape[1]):
                share = col_share[col, k]
                red += share * line[at]
                green += share * line[at + 1]
                blue += share * line[at + 2]
                at += 3
            small[row, col, 0] = np.uint8(np.rint(red))
            small[row, col, 1] = np.uint8(np.rint(green))
            small[row, col, 2] = np.uint8(np.rint(blue))


@kernel(nogil=True, fastmath={"contract", "nsz"})
def _interpolate(
    probabilities: Float32Array,
    row_first: Int32Array,
    row_weight: Float32Array,
    col_first: Int32Array,
    col_weight: Float32Array,
    winner: UInt8Array,
    confidence: UInt8Array,
) -> None:
    """Upsample row by row. Where one class is the likeliest on both sides of a pixel it is so between them, and the
    others are not looked at."""
    classes, rows, cols = probabilities.shape
    height, width = winner.shape
    lines = np.empty((classes, cols + 1), dtype=np.float32)
    likeliest = np.empty(cols + 1, dtype=np.uint8)
    peak = np.empty(cols + 1, dtype=np.float32)
    best = np.empty(width, dtype=np.float32)
    starts = np.searchsorted(col_first, np.arange(cols + 1)).astype(np.int32)
    for row in range(height):
        upper = row_first[row]
        lower = min(upper + 1, rows - 1)
        down = row_weight[row]
        likeliest[:] = 0
        peak[:] = np.float32(-1.0)  # networks may give probabilities a thousandth below 0
        for k in range(classes):
            for col in range(cols):
                above = probabilities[k, upper, col]
                value = above + down * (probabilities[k, lower, col] - above)
                lines[k, col] = value
                likeliest[col] = k if value > peak[col] else likeliest[col]
                peak[col] = max(value, peak[col])
            lines[k, cols] = lines[k, cols - 1]
        likeliest[cols], peak[cols] = likeliest[cols - 1], peak[cols - 1]
        for col in range(width):
            left = peak[col_first[col]]
            best[col] = left + col_weight[col] * (peak[col_first[col] + 1] - left)
            winner[row, col] = likeliest[col_first[col]]
        for cell in range(cols):
            if likeliest[cell] == likeliest[cell + 1]:
                continue
            for col in range(starts[cell], starts[cell + 1]):
                best[col] = np.float32(-1.0)
                for k in range(classes):
                    left = lines[k, cell]
                    value = left + col_weight[col] * (lines[k, cell + 1] - left)
                    if value > best[col]:
                        best[col] = value
                        winner[row, col] = k
        for col in range(width):
            confidence[row, col] = np.uint8(best[col] * np.float32(255.0) + np.float32(0.5))
