"""Fits depth without a scale to the true depth, by least squares for scale and shift: its best possible result."""

from __future__ import annotations

from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array, Int64Array

Value = TypeVar("Value", bound=np.generic)

DepthKind = Literal["relative_inverse", "affine_invariant", "metric"]
"""Inverse depth but for scale and shift; depth but for scale and shift; metres."""


def fit_to_truth(values: Float32Array, truth: Float32Array, kind: DepthKind) -> Float32Array:
    """`values` (H, W) as metres: scale and shift by least squares over the pixels of finite truth.

    The protocol by which networks of relative depth are compared (Ranftl et al. 2020, "Towards robust monocular depth
    estimation", section 6): inverse depth is fitted in inverse depth, and the result is held below the largest true
    depth. Metric values come back as they are. Raises ImageError on different shapes.
    """
    if values.shape != truth.shape:
        raise ImageError(f"depth of {values.shape} cannot be fitted to truth of {truth.shape}")
    both = np.isfinite(values) & np.isfinite(truth) & (truth > 0)
    if kind == "metric" or both.sum() < 2:
        return values
    inverse = kind == "relative_inverse"
    x, y = values[both].astype(np.float64), truth[both].astype(np.float64)
    scale, shift = np.linalg.lstsq(np.column_stack([x, np.ones_like(x)]), 1 / y if inverse else y, rcond=None)[0]
    fitted = scale * values.astype(np.float64) + shift
    farthest = y.max()
    if inverse:
        fitted = 1 / np.maximum(fitted, 1 / farthest)
    return np.asarray(np.clip(fitted, 0, farthest), np.float32)


def at_pixels_of(depth: NDArray[Value], image: tuple[int, int], shape: tuple[int, ...]) -> NDArray[Value]:
    """`depth`, or labels, at the pixels that truth of `shape` (h, w) samples of an `image` (H, W): every n-th from 0.

    An array of any other size is taken to cover the same field of view and is read at the nearest pixel. Raises
    ImageError where truth is no such sampling.
    """
    step = max(1, round(image[1] / shape[1]))
    if (-(-image[0] // step), -(-image[1] // step)) != tuple(shape):
        raise ImageError(f"truth of {shape} is no sampling of an image of {image}")
    if depth.shape == shape:
        return depth
    if depth.shape == image:
        return depth[::step, ::step]
    rows = _nearest(np.arange(shape[0]) * step, image[0], depth.shape[0])
    cols = _nearest(np.arange(shape[1]) * step, image[1], depth.shape[1])
    return np.asarray(depth[rows[:, None], cols])


def _nearest(places: Int64Array, size: int, other: int) -> Int64Array:
    """The pixels of a row of `other` pixels that lie where `places` lie in one of `size`."""
    return np.asarray(np.clip(np.floor((places + 0.5) * other / size), 0, other - 1), np.int64)
