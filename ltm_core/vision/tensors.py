"""Upsample class probabilities to the photo's resolution: the winning class of each pixel and its probability."""

import numba
import numpy as np

from ltm_core.base.types import Float32Array, Int32Array, UInt8Array


def upsampled_winner(probabilities: Float32Array, height: int, width: int) -> tuple[UInt8Array, UInt8Array]:
    """Return the most probable class of each pixel of a `height` x `width` image, interpolated bilinearly.

    `probabilities` is (K, h, w) float32 in 0..1. Both grids cover the same field of view edge to edge (pixel
    centres at half-integers, as in `cv2.resize`). Returns (H, W) uint8 indices into K, the lower one on a tie, and
    (H, W) uint8 probability x 255, rounded. One pass, no (K, H, W) array in between.
    """
    _, rows, cols = probabilities.shape
    row_below, row_weight = _neighbours(rows, height)
    col_right, col_weight = _neighbours(cols, width)
    winner = np.empty((height, width), dtype=np.uint8)
    confidence = np.empty((height, width), dtype=np.uint8)
    _interpolate(
        np.ascontiguousarray(probabilities, dtype=np.float32),
        row_below,
        row_weight,
        col_right,
        col_weight,
        winner,
        confidence,
    )
    return winner, confidence


def _neighbours(size: int, target: int) -> tuple[Int32Array, Float32Array]:
    """For each of `target` samples the index of the first of its two source samples, and the second's weight."""
    centre = (np.arange(target) + 0.5) * (size / target) - 0.5
    centre = np.clip(centre, 0.0, size - 1.0)
    first = np.minimum(centre.astype(np.int32), max(size - 2, 0)).astype(np.int32)
    return first, (centre - first).astype(np.float32)


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz"})  # type: ignore[untyped-decorator]
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
