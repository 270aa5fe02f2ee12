"""Pixels where the terrain can be trusted: what a network's depth is fitted to."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from ltm_core.depth.expected_surface import JUMP
from ltm_core.types import BoolArray, Float32Array, Float64Array, IndexArray, UInt8Array

MOST = 6000
"""Samples that a fit gets at most."""
CROWD = 4
GRAZING_DEG = 4.0
"""Least angle between ray and ground."""
UNSURE = 0.3
"""Relative sigma from which on a depth says nothing of scale. Ground near a low mast is unsure, but a network must not
be left without what is near."""
_STEP = 6  # pixels between candidates
_CLEAR = 5  # pixels within which no silhouette may lie


@dataclass(frozen=True, eq=False)
class GroundSamples:
    """`rows`, `cols`: (N,) pixels of the photo; `depth`, `sigma`: (N,) float64 metres of the surface there."""

    rows: IndexArray
    cols: IndexArray
    depth: Float64Array
    sigma: Float64Array

    def __len__(self) -> int:
        return len(self.rows)

    def part(self, chosen: BoolArray) -> GroundSamples:
        """Those that `chosen` (N,) names."""
        return GroundSamples(self.rows[chosen], self.cols[chosen], self.depth[chosen], self.sigma[chosen])


def ground_samples(
    surface: Float32Array,
    sigma: Float32Array,
    labels: UInt8Array | None,
    ground: BoolArray,
    focal: float,
) -> GroundSamples:
    """Evenly spread pixels with terrain that is no sky, at no silhouette, not grazed, and of a class that is ground.

    `ground`: (256,) which classes are. `focal`: pixels. Sigmas above UNSURE of the depth are left out as well.
    """
    rows, cols, depth = _candidates(
        surface,
        sigma,
        np.zeros((1, 1), np.uint8) if labels is None else labels,
        labels is not None,
        ground,
        np.float32(2.0 / (focal * np.tan(np.radians(GRAZING_DEG)))),
    )
    chosen = _even(depth)
    rows, cols = rows[chosen], cols[chosen]
    return GroundSamples(rows, cols, depth[chosen].astype(np.float64), sigma[rows, cols].astype(np.float64))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _candidates(
    surface: Float32Array,
    sigma: Float32Array,
    labels: UInt8Array,
    labelled: bool,
    ground: BoolArray,
    steep: np.float32,
) -> tuple[IndexArray, IndexArray, Float32Array]:
    """Rows, columns and depth of the pixels of a grid that are fit. `steep`: relative change of depth over two rows
    that is grazed."""
    height, width = surface.shape
    down, across = (height - 2 * _CLEAR + _STEP - 1) // _STEP, (width - 2 * _CLEAR + _STEP - 1) // _STEP
    count = max(down, 0) * max(across, 0)
    rows, cols, depth = np.empty(count, np.intp), np.empty(count, np.intp), np.empty(count, np.float32)
    far, jump, unsure = np.float32(1e9), np.float32(JUMP), np.float32(UNSURE)
    i = 0
    for v in range(_CLEAR, height - _CLEAR, _STEP):
        for u in range(_CLEAR, width - _CLEAR, _STEP):
            d = surface[v, u]
            good = d < far and d > 0 and sigma[v, u] < unsure * d and (not labelled or ground[labels[v, u]])
            if good:
                for beside in (
                    surface[v + _CLEAR, u],
                    surface[v - _CLEAR, u],
                    surface[v, u - _CLEAR],
                    surface[v, u + _CLEAR],
                ):
                    good &= beside < jump * d and d < jump * beside
                # The rise of the depth in a pixel's angle is the cotangent of the angle between ray and ground.
                good &= abs(surface[v - 1, u] - surface[v + 1, u]) < steep * d
            if good:
                rows[i], cols[i], depth[i] = v, u, d
                i += 1
    return rows[:i], cols[:i], depth[:i]


def _even(depth: Float32Array) -> IndexArray:
    """Which of the samples (N,) to keep, so that what fills most of a photo does not decide for all ranges: no class of
    ranges gets more than CROWD times the places of a middling one."""
    if not len(depth):
        return np.empty(0, np.intp)
    octave = np.floor(2.0 * np.log2(depth)).astype(np.intp)
    octave -= octave.min()
    counts = np.bincount(octave)
    filled = counts[counts > 0]
    most = CROWD * np.median(filled)
    while np.minimum(filled, most).sum() > MOST:
        most *= 0.9
    return np.asarray(_evenly(octave, np.minimum(1.0, most / np.maximum(counts, 1))))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _evenly(kind: IndexArray, share: Float64Array) -> IndexArray:
    """Which to keep of things (N,) of several kinds, that `share` of each kind: evenly spread, since they come row by
    row."""
    chosen, rank, n = np.empty(len(kind), np.intp), np.zeros(len(share), np.intp), 0
    for i in range(len(kind)):
        k = kind[i]
        before = np.floor(rank[k] * share[k])
        rank[k] += 1
        if np.floor(rank[k] * share[k]) > before:
            chosen[n] = i
            n += 1
    return chosen[:n]
