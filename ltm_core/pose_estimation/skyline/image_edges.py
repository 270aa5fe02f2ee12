"""Find the edges of a photo that poses are compared with: contours, and the sky's lower edge."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ltm_core.base.kernels import kernel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int64Array, UInt8Array
from ltm_core.vision.label_rules import cie_lab
from ltm_core.vision.labels import Label

ORIENTATIONS = 8


@dataclass(frozen=True, eq=False)
class ImageContours:
    """`response`: (ORIENTATIONS, h, w) float32, of an edge whose normal stands at k 180/ORIENTATIONS degrees from the
    image's u axis towards v, in units of the change that is usual around. `scale`: of its pixels, to the photo's."""

    response: Float32Array
    scale: float


def image_contours(photo: UInt8Array, width: int, hidden: BoolArray | None = None) -> ImageContours:
    """Compute the edges of a photo (H, W, 3) at the given width in pixels; `hidden` (H, W): areas without edges, clouds
    and masks.

    The gradient over its local root mean square; of it, what stands across the line, less 0.7 of what runs along it."""
    full_height, full_width = photo.shape[:2]
    size = (width, max(2, round(full_height * width / full_width)))
    small = cv2.resize(photo, size, interpolation=cv2.INTER_AREA) if full_width > width else photo
    lab = cie_lab(np.asarray(cv2.GaussianBlur(small, (0, 0), 1.0), np.uint8))
    # Of the three channels' gradients, that which is strongest.
    gu = np.stack([cv2.Scharr(lab[..., c], cv2.CV_32F, 1, 0) for c in range(3)])
    gv = np.stack([cv2.Scharr(lab[..., c], cv2.CV_32F, 0, 1) for c in range(3)])
    strongest = np.argmax(gu * gu + gv * gv, axis=0)[None]
    gu, gv = np.take_along_axis(gu, strongest, 0)[0], np.take_along_axis(gv, strongest, 0)[0]
    if hidden is not None:
        shut = cv2.resize(hidden.astype(np.uint8), (gu.shape[1], gu.shape[0]), interpolation=cv2.INTER_NEAREST)
        shut = cv2.dilate(shut, np.ones((5, 5), np.uint8)) > 0
        gu[shut], gv[shut] = 0.0, 0.0
    window = max(5, gu.shape[1] // 16) | 1
    power = cv2.boxFilter(gu * gu + gv * gv, cv2.CV_32F, (window, window), borderType=cv2.BORDER_REFLECT)
    usual = np.sqrt(power) + np.float32(1e-3) + np.float32(0.15) * np.float32(np.sqrt(power.mean()))
    gu, gv = gu / usual, gv / usual
    response = np.empty((ORIENTATIONS, *gu.shape), np.float32)
    for k in range(ORIENTATIONS):
        angle = np.pi * k / ORIENTATIONS
        c, s = np.float32(np.cos(angle)), np.float32(np.sin(angle))
        across, along = np.abs(gu * c + gv * s), np.abs(gv * c - gu * s)
        np.maximum(across - np.float32(0.7) * along, 0.0, out=response[k])
    return ImageContours(np.minimum(response, np.float32(4.0)), full_width / gu.shape[1])


COLUMNS = 240
_RUN = 3  # number of consecutive rows of land that end the sky
_REACH = 7.0 / 640  # distance around the labels' edge to search, as a share of the width; sigma is half of it
_FAINT = 2.0
"""Gradient in units of CIE Lab at which an edge is known twice as well as by the labels alone. Far ridges in rendered
haze err by 0.35 pixels from gradients of 5, which corresponds to 1.4; edges in photos are less sharp."""
_SHARP_PX = 0.45  # standard deviation of sharp edges in pixels


@dataclass(frozen=True, eq=False)
class ImageSkyline:
    """The sky's lower edge in up to COLUMNS columns of an image.

    `u`, `v`: (K,) pixels, where sky ends. `sigma_px`: (K,) of v; `cover`: (K,) label below. `spacing`: of columns."""

    u: Float64Array
    v: Float64Array
    sigma_px: Float64Array
    cover: UInt8Array
    spacing: float

    def only(self, kept: BoolArray) -> ImageSkyline:
        """Return the skyline of those columns (K,) only."""
        columns = {name: getattr(self, name)[kept] for name in ("u", "v", "sigma_px", "cover")}
        return replace(self, **columns)


def image_skyline(photo: UInt8Array, labels: UInt8Array) -> ImageSkyline:
    """Find the skyline of a photo (H, W, 3) with its labels (H, W)."""
    height, width = labels.shape
    spacing = max(1.0, width / COLUMNS)
    columns = np.unique((np.arange(spacing / 2, width, spacing)).astype(np.int64))
    sky = labels == np.uint8(Label.SKY)
    top = _first_land(sky, columns, _RUN)
    # A column without any sky is covered by the terrain; "sky" that starts below land is a gap between trees.
    edge = (top > 1) & (top < height - _RUN)
    u, rows = columns[edge], top[edge]
    reach = max(3.0, _REACH * width)
    strength = _vertical_gradient(photo)
    v, sharpness = _sharpened(strength, u, rows, reach)
    # Below the labels' own edge, too: what stands between the two edges is called sky.
    below = np.minimum(np.maximum(np.rint(v).astype(np.int64), rows) + max(2, height // 180), height - 1)
    # Hardly an edge at all (haze, cloud on the crest): no better than the labels.
    blurred = 0.5 * reach / (1.0 + (sharpness / _FAINT) ** 2)
    fine = max(1.0, width / 1280)
    sigma = np.asarray(np.hypot(_SHARP_PX * fine, blurred), np.float64)
    return ImageSkyline(u.astype(np.float64), v, sigma, labels[below, u], spacing)


def _vertical_gradient(photo: UInt8Array) -> Float32Array:
    """Return how much the colour changes from the row above to that below each pixel, (H, W), in units of CIE Lab."""
    lab = cv2.cvtColor(cv2.GaussianBlur(photo, (0, 0), 1.0), cv2.COLOR_RGB2LAB).astype(np.float32)
    change = np.zeros_like(lab)
    change[1:-1] = lab[2:] - lab[:-2]
    change[..., 0] *= np.float32(100 / 255)
    return np.asarray(np.sqrt(np.einsum("hwc,hwc->hw", change, change)), np.float32)


@kernel(nogil=True)
def _first_land(sky: BoolArray, columns: Int64Array, run: int) -> Int64Array:
    """Return the first row from which on `run` rows are no sky; H without."""
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


@kernel(nogil=True)
def _sharpened(
    strength: Float32Array, columns: Int64Array, rows: Int64Array, reach: float
) -> tuple[Float64Array, Float64Array]:
    """Return the edge of each column (K,), by a parabola through the strongest gradient, and its strength."""
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
