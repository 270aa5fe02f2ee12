"""Find the edges of a photo that poses are compared with: contours, and the sky's lower edge."""

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
    and masks. The gradient over its local root mean square; of it, what stands across the line, less 0.7 of what runs
    along it."""
    full_height, full_width = photo.shape[:2]
    size = (width, max(2, round(full_height * width / full_width)))
    small = cv2.resize(photo, size, interpolation=cv2.INTER_AREA) if full_width > width else photo
    lab = cie_lab(np.asarray(cv2.GaussianBlur(small, (0, 0), 1.0), np.uint8))
    # Of the three channels' gradients, that which is strongest.
    gradients = [np.stack([cv2.Scharr(lab[..., c], cv2.CV_32F, *axis) for c in range(3)]) for axis in ((1, 0), (0, 1))]
    strongest = np.argmax(gradients[0] ** 2 + gradients[1] ** 2, axis=0)[None]
    gu, gv = (np.take_along_axis(gradient, strongest, 0)[0] for gradient in gradients)
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
    """The sky's lower edge in up to COLUMNS columns of an image. `u`, `v`: (K,) pixels, where sky ends. `sigma_px`:
    (K,) of v; `cover`: (K,) label below. `spacing`: of columns."""

    u: Float64Array
    v: Float64Array
    sigma_px: Float64Array
    cover: UInt8Array
    spacing: float

    def only(self, kept: BoolArray) -> "ImageSkyline":
        """Return the skyline of those columns (K,) only."""
        columns = {name: getattr(self, name)[kept] for name in ("u", "v", "sigma_px", "cover")}
        return replace(self, **columns)


def image_skyline(photo: UInt8Array, labels: UInt8Array) -> ImageSkyline:
    """Find the skyline of a photo (H, W, 3) with its labels (H, W)."""
    height, width = labels.shape
    spacing = max(1.0, width / COLUMNS)
    columns = np.unique((np.arange(spacing / 2, width, spacing)).astype(np.int64))
    sky = labels == np.uint8(Label.SKY)
    land = ~np.pad(sky[:, columns], ((0, _RUN - 1), (0, 0)), constant_values=True)
    runs = np.logical_and.reduce([land[k : height + k] for k in range(_RUN)])
    top = np.where(runs.any(axis=0), runs.argmax(axis=0), height)  # the first row of land that goes on
    # A column without any sky is covered by the terrain; "sky" that starts below land is a gap between trees.
    edge = (top > 1) & (top < height - _RUN)
    u, rows = columns[edge], top[edge]
    reach = max(3.0, _REACH * width)
    # Of the colour from the row above to that below each pixel, in units of CIE Lab.
    change, lab = np.zeros(photo.shape, np.float32), cie_lab(np.asarray(cv2.GaussianBlur(photo, (0, 0), 1.0), np.uint8))
    change[1:-1] = lab[2:] - lab[:-2]
    strength = np.sqrt(np.einsum("hwc,hwc->hw", change, change))
    v, sharpness = _sharpened(strength, u, rows, reach)
    # Below the labels' own edge, too: what stands between the two edges is called sky.
    below = np.minimum(np.maximum(np.rint(v).astype(np.int64), rows) + max(2, height // 180), height - 1)
    # Hardly an edge at all (haze, cloud on the crest): no better than the labels.
    blurred = 0.5 * reach / (1.0 + (sharpness / _FAINT) ** 2)
    fine = max(1.0, width / 1280)
    sigma = np.asarray(np.hypot(_SHARP_PX * fine, blurred), np.float64)
    return ImageSkyline(u.astype(np.float64), v, sigma, labels[below, u], spacing)


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
