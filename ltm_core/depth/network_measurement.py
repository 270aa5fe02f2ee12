"""What a network alone measures, for whoever asks whether the terrain is still what it was.

Fused depth holds the terrain's word: it takes one side where the two disagree, and is drawn to it where they do not. A
map of what has changed must be told what was seen, and how surely, without it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from ltm_core.depth.error_model import invert
from ltm_core.depth.pixel_fusion import elsewhere
from ltm_core.depth.scale_fit import ScaleFit
from ltm_core.types import Float32Array

_SURE = 0.5
"""Relative sigma from which on a depth measures nothing."""


@dataclass(frozen=True, eq=False)
class NetworkMeasurement:
    """`depth`, `sigma`: (h, w) float32 metres along the optical axis, at the network's own size, edge to edge over the
    photo; NaN where nothing is measured."""

    depth: Float32Array
    sigma: Float32Array

    @classmethod
    def of(cls, fit: ScaleFit) -> NetworkMeasurement:
        """From a fit that can be used. What is seen may not be the ground on which the network was fitted, so sigma is
        that of what stands before it."""
        depth, sigma = np.empty_like(fit.inverse), np.empty_like(fit.inverse)
        _measure(fit.inverse, fit.nearest, fit.farthest, fit.error_model.shift, fit.error_model.factor, depth, sigma)
        return cls(depth, sigma)

    @classmethod
    def none(cls) -> NetworkMeasurement:
        """Of a photo that no network measures."""
        nothing = np.full((1, 1), np.nan, np.float32)
        return cls(nothing, nothing)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _measure(
    inverse: Float32Array,
    nearest: Float32Array,
    farthest: Float32Array,
    shift: Float32Array,
    factor: Float32Array,
    depth: Float32Array,
    sigma: Float32Array,
) -> None:
    height, width = inverse.shape
    one, none = np.float32(1.0), np.float32(np.nan)
    for v in range(height):
        row = v * shift.shape[0] // height
        for u in range(width):
            depth[v, u], sigma[v, u] = none, none
            if inverse[v, u] > 0:
                true, t = invert(row, u * shift.shape[1] // width, inverse[v, u], shift, factor)
                t = elsewhere(t, nearest[v, u], farthest[v, u])
                if t < np.float32(_SURE) * true:
                    depth[v, u], sigma[v, u] = one / true, t / (true * true)
