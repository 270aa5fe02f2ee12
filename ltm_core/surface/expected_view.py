"""Expected view of the reference surface: range, cell and slope for each pixel, without an image.

None of it depends on the image, so it is kept, and a camera that stands still pays for it once."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Float32Array, Float64Array, RecordArray
from ltm_core.surface.cell_layout import place_of
from ltm_core.surface.reference_surface import (
    LEAST_INCIDENCE,
    ReferenceGrid,
    cell_at,
    pose_variance,
    slopes_at,
    steepness,
)

EXPECTED_PIXEL = np.dtype(
    [("expected", "f4"), ("nearest", "f4"), ("farthest", "f4"), ("spread", "f4"), ("place", "i4"), ("incidence", "f4"),
     ("steep", "f4"), ("pose_variance", "f4")]
)  # fmt: skip
"""Expected view of one pixel: the slant range that the reference predicts, its extremes within the pose's uncertainty,
and half of its variation within the pixel (metres); the index of the visible cell (-1: none); the incidence factor on
the slope of its block, and the larger of that and the one on its own slope; and the variance of its height due to the
pose."""


class CameraView(NamedTuple):
    """One frame's camera: rays (H, W, 3) in the optical frame, rotation to the map, position, pose covariance, and the
    bend of a ray over its horizontal range."""

    rays: Float64Array
    rotation: Float64Array
    position: Float64Array
    covariance: Float64Array
    bend: float


class Extremes(NamedTuple):
    """Least and greatest of the expected ranges (H, W), unknown ones counted as infinite: within the pose's
    uncertainty, and within one pixel."""

    nearest: Float32Array
    farthest: Float32Array
    near: Float32Array
    far: Float32Array


@helper(inline="always")
def direction(view: CameraView, v: int, u: int) -> tuple[float, float, float]:
    """Return the unit vector of a pixel's ray in the map frame."""
    m = view.rotation
    a, b, c = view.rays[v, u, 0], view.rays[v, u, 1], view.rays[v, u, 2]
    return (
        m[0, 0] * a + m[0, 1] * b + m[0, 2] * c,
        m[1, 0] * a + m[1, 1] * b + m[1, 2] * c,
        m[2, 0] * a + m[2, 1] * b + m[2, 2] * c,
    )


@kernel()
def predict_view(
    ground: ReferenceGrid, view: CameraView, expected: Float32Array, extremes: Extremes, pixels: RecordArray
) -> None:
    """Fill `pixels` (H, W) of EXPECTED_PIXEL with each pixel's view of the reference."""
    rows, cols = expected.shape
    x0, y0 = view.position[0], view.position[1]
    for v in range(rows):
        for u in range(cols):
            one = pixels[v, u]
            e = float(expected[v, u])
            one.expected = e
            one.nearest, one.farthest = extremes.nearest[v, u], extremes.farthest[v, u]
            one.place = -1
            one.spread = one.incidence = one.steep = one.pose_variance = 0.0
            if not e < math.inf:
                continue
            # Where neighbouring pixels see other ranges, a pixel's own direction is not exact enough.
            if not math.isinf(extremes.far[v, u]):
                one.spread = 0.5 * (extremes.far[v, u] - extremes.near[v, u])
            elif not math.isinf(extremes.near[v, u]):
                one.spread = e - extremes.near[v, u]
            dx, dy, dz = direction(view, v, u)
            x, y = x0 + dx * e, y0 + dy * e
            row, col = cell_at(ground, x, y)
            if row < 0:
                continue
            east, north = slopes_at(ground, row, col)
            incidence = max(abs(dz - east * dx - north * dy), LEAST_INCIDENCE)
            one.place = place_of(row, col, ground.across)
            one.incidence = incidence
            one.steep = max(incidence, steepness(ground, row, col, dx, dy, dz))
            z = dz * e + view.bend * (dx * dx + dy * dy) * e * e
            one.pose_variance = pose_variance(view.covariance, east, north, x - x0, y - y0, z)
