"""The sky's lower edge in a photo: where the labels have it, moved to the strongest edge nearby, to part of a pixel,
and from there to that of far land, pale before the sky, where some stands above it (`pale_land`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numba import njit

from ltm_core.pose_estimation.pale_land import pale_edges
from ltm_core.types import BoolArray, Float32Array, Float64Array, Int64Array, UInt8Array
from ltm_core.vision.labels import Label

COLUMNS = 240
_RUN = 3
"""Rows of land under each other that end the sky."""
_REACH = 7.0 / 640
"""Widths of the image within which the edge is sought about the labels' edge, one sigma at half of it."""
_FAINT = 2.0
"""A gradient, in units of CIE Lab, by which an edge is known twice as well as by the labels alone. Far ranges in
rendered haze err by 0.35 pixels from gradients of 5 on, which 1.4 would state: a photo's edges are less sharp."""
_SHARP_PX, _PALE_PX = 0.45, 0.5
"""What sharp edges err by, and those of pale land besides."""


@dataclass(frozen=True, eq=False)
class ImageSkyline:
    """The sky's lower edge in up to COLUMNS columns of an image.

    `u`, `v`: (K,) pixels, where sky ends; `crest_v`: (K,) where nearer land begins below that, which is at `v` where no
    pale land stands above it. `sigma_px`: (K,) of v; `cover`: (K,) uint8 label right below the crest. `covered_u`: (C,)
    columns that are land up to the image's upper edge. `spacing`: pixels between columns.
    """

    u: Float64Array
    v: Float64Array
    crest_v: Float64Array
    sigma_px: Float64Array
    cover: UInt8Array
    covered_u: Float64Array
    spacing: float

    def only(self, kept: BoolArray) -> ImageSkyline:
        """Of those columns (K,) alone."""
        return replace(
            self,
            u=self.u[kept],
            v=self.v[kept],
            crest_v=self.crest_v[kept],
            sigma_px=self.sigma_px[kept],
            cover=self.cover[kept],
        )


def image_skyline(photo: UInt8Array, labels: UInt8Array) -> ImageSkyline:
    """Of a photo (H, W, 3) and its labels (H, W)."""
    height, width = labels.shape
    spacing = max(1.0, width / COLUMNS)
    columns = np.unique((np.arange(spacing / 2, width, spacing)).astype(np.int64))
    sky = labels == np.uint8(Label.SKY)
    top = _first_land(sky, columns, _RUN)
    # A column without any sky says that the terrain covers it; one whose "sky" starts below land is a hole in trees.
    covered = top <= 1
    edge = (top > 1) & (top < height - _RUN)
    u, rows = columns[edge], top[edge]
    reach = max(3.0, _REACH * width)
    strength = _vertical_gradient(photo)
    crest_v, sharpness = _sharpened(strength, u, rows, reach)
    v = pale_edges(photo, u, crest_v)
    # Below the labels' own edge, too: what stands between the two edges is called sky.
    below = np.minimum(np.maximum(np.rint(crest_v).astype(np.int64), rows) + max(2, height // 180), height - 1)
    # Hardly an edge at all (haze, cloud on the crest): no better than the labels.
    blurred = 0.5 * reach / (1.0 + (sharpness / _FAINT) ** 2)
    fine = max(1.0, width / 1280)
    sigma = np.hypot(_SHARP_PX * fine, np.where(v < crest_v, _PALE_PX * fine, blurred))
    return ImageSkyline(
        u.astype(np.float64),
        v,
        crest_v,
        np.asarray(sigma, np.float64),
        labels[below, u],
        columns[covered].astype(np.float64),
        spacing,
    )


def _vertical_gradient(photo: UInt8Array) -> Float32Array:
    """How much the colour changes from the row above to that below each pixel, (H, W), in units of CIE Lab."""
    lab = cv2.cvtColor(cv2.GaussianBlur(photo, (0, 0), 1.0), cv2.COLOR_RGB2LAB).astype(np.float32)
    change = np.zeros_like(lab)
    change[1:-1] = lab[2:] - lab[:-2]
    change[..., 0] *= np.float32(100 / 255)
    return np.asarray(np.sqrt(np.einsum("hwc,hwc->hw", change, change)), np.float32)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator]
def _first_land(sky: BoolArray, columns: Int64Array, run: int) -> Int64Array:
    """The first row from which on `run` rows are no sky; H without."""
    height = sky.shape[0]
    top = np.full(len(columns), height, np.int64)
    for k in range(len(columns)):
        length = 0
        for v in range(height):
            length = 0 if sky[v, columns[k]] else length + 1
            if length == run:
                top[k] = v - run + 1
                break
    return top


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _sharpened(
    strength: Float32Array, columns: Int64Array, rows: Int64Array, reach: float
) -> tuple[Float64Array, Float64Array]:
    """The edge of each column (K,), by a parabola through the strongest gradient near the labels' edge, and how strong
    it is."""
    height = strength.shape[0]
    v, sharpness = np.empty(len(columns)), np.empty(len(columns))
    for k in range(len(columns)):
        middle = rows[k] - 0.5
        best, at = -1.0, rows[k]
        for row in range(max(1, int(middle - reach)), min(height - 1, int(middle + reach) + 2)):
            z = (row - middle) / (0.5 * reach)
            value = strength[row, columns[k]] * np.exp(-0.5 * z * z)
            if value > best:
                best, at = value, row
        # From there to the crest of the gradient itself: the labels' edge only says which one.
        while at + 2 < height and strength[at + 1, columns[k]] > strength[at, columns[k]]:
            at += 1
        while at > 1 and strength[at - 1, columns[k]] > strength[at, columns[k]]:
            at -= 1
        a, b, c = strength[at - 1, columns[k]], strength[at, columns[k]], strength[at + 1, columns[k]]
        curve = a - 2 * b + c
        part = 0.5 * (a - c) / curve if curve < 0 else 0.0
        v[k] = at + min(max(part, -0.5), 0.5)
        sharpness[k] = b
    return v, sharpness
