"""Pixels where the terrain can be trusted: what a network's depth is fitted to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ltm_core.depth.surface import JUMP

Floats = NDArray[np.float64]

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

    rows: NDArray[np.intp]
    cols: NDArray[np.intp]
    depth: Floats
    sigma: Floats

    def __len__(self) -> int:
        return len(self.rows)

    def part(self, chosen: NDArray[np.bool_]) -> GroundSamples:
        """Those that `chosen` (N,) names."""
        return GroundSamples(self.rows[chosen], self.cols[chosen], self.depth[chosen], self.sigma[chosen])


def ground_samples(
    surface: NDArray[np.float32],
    sigma: NDArray[np.float32],
    labels: NDArray[np.uint8] | None,
    ground: NDArray[np.bool_],
    focal: float,
) -> GroundSamples:
    """Evenly spread pixels with terrain that is no sky, at no silhouette, not grazed, and of a class that is ground.

    `ground`: (256,) which classes are. `focal`: pixels. Sigmas above UNSURE of the depth are left out as well.
    """
    height, width = surface.shape
    rows, cols = np.arange(_CLEAR, height - _CLEAR, _STEP), np.arange(_CLEAR, width - _CLEAR, _STEP)
    at = np.ix_(rows, cols)
    here = surface[at]
    with np.errstate(invalid="ignore"):
        good = np.isfinite(here) & (here > 0) & (sigma[at] < UNSURE * here)
        for down, right in ((-_CLEAR, 0), (_CLEAR, 0), (0, -_CLEAR), (0, _CLEAR)):
            beside = surface[np.ix_(rows + down, cols + right)]
            good &= (beside < JUMP * here) & (here < JUMP * beside)
        # The rise of the depth in a pixel's angle is the cotangent of the angle between ray and ground.
        steep = np.abs(surface[np.ix_(rows - 1, cols)] - surface[np.ix_(rows + 1, cols)]) * (focal / 2)
        good &= steep < here / np.tan(np.radians(GRAZING_DEG))
    if labels is not None:
        good &= ground[labels[at]]
    row, col = np.nonzero(good)
    kept = _even(here[row, col])
    row, col = row[kept], col[kept]
    return GroundSamples(
        rows[row], cols[col], here[row, col].astype(np.float64), sigma[at][row, col].astype(np.float64)
    )


def _even(depth: NDArray[np.float32]) -> NDArray[np.intp]:
    """Which of the samples (N,) to keep, so that what fills most of a photo does not decide for all ranges: no class of
    ranges gets more than CROWD times the places of a middling one."""
    if not len(depth):
        return np.empty(0, np.intp)
    octave = np.floor(2.0 * np.log2(depth)).astype(np.int64)
    _, index, counts = np.unique(octave, return_inverse=True, return_counts=True)
    most = CROWD * np.median(counts)
    while np.minimum(counts, most).sum() > MOST:
        most *= 0.9
    # Evenly spread over the image, since candidates come row by row.
    rank = np.empty(len(depth), np.int64)
    order = np.argsort(index, kind="stable")
    rank[order] = np.arange(len(depth)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = np.minimum(1.0, most / counts)[index]
    return np.flatnonzero(np.floor((rank + 1) * share) > np.floor(rank * share))
