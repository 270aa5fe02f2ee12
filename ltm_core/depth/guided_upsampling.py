"""Upsample a network's fitted depth to the photo's size, with the photo's edges.

Source: He and Sun, Fast Guided Filter, arXiv:1505.00996 (2015): in each window the small image is taken as a line of
the photo's grey values; gain and offset vary slowly, so they can be enlarged bilinearly and applied at full size."""

from typing import NamedTuple

import cv2
import numpy as np

from ltm_core.base.kernels import helper
from ltm_core.base.types import Float32Array, Int32Array, UInt8Array
from ltm_core.depth.error_model import ErrorModel
from ltm_core.depth.fusion_config import FusionConfig, UpsamplingConfig
from ltm_core.depth.scale_fit import ScaleFit
from ltm_core.vision.resampling import neighbours


def guided_coefficients(
    image: Float32Array, grey: UInt8Array, config: UpsamplingConfig
) -> tuple[Float32Array, Float32Array]:
    """Return the gain and offset (h, w) so that `image` is gain * grey + offset with the edges of `grey` (H, W),
    0..255. NaN in `image` spreads by twice the windows' radius."""
    height, width = image.shape
    guide: Float32Array = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    window = (2 * config.radius + 1, 2 * config.radius + 1)

    def mean(a: Float32Array) -> Float32Array:
        return np.asarray(cv2.blur(a, window, borderType=cv2.BORDER_REFLECT), np.float32)

    guide_mean, image_mean = mean(guide), mean(image)
    covariance = mean((guide * image).astype(np.float32)) - guide_mean * image_mean
    variance = mean((guide * guide).astype(np.float32)) - guide_mean * guide_mean
    gain = covariance / (np.maximum(variance, 0) + config.edge**2)
    offset = image_mean - gain * guide_mean
    return mean(gain.astype(np.float32)), mean(offset.astype(np.float32))


class NetworkView(NamedTuple):
    """A network's view of a photo, kept at the network's size, as compiled code takes it.

    `cells`: (4, h, w) float32 over the photo, edge to edge: gain and offset on the photo's `grey` (H, W), then the
    greatest and the least inverse depth, 1/m, among neighbours. `columns`, `parts`: for each column of the photo the
    cell to its left, and how far it lies towards the next. `errors`: the network's error model. `gross`: see
    `ScaleFit`. `there`: whether there is a network at all."""

    cells: Float32Array
    grey: UInt8Array
    columns: Int32Array
    parts: Float32Array
    errors: ErrorModel
    gross: np.float32
    there: bool

    @classmethod
    def of(cls, fit: ScaleFit, rgb: UInt8Array, config: FusionConfig) -> "NetworkView":
        grey = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
        gain, offset = guided_coefficients(fit.inverse, grey, config.upsampling)
        cells = np.stack([gain, offset, fit.nearest, fit.farthest])
        columns, parts = neighbours(cells.shape[2], grey.shape[1])
        return cls(cells, grey, columns, parts, fit.error_model, np.float32(fit.gross), True)

    @classmethod
    def none(cls) -> "NetworkView":
        """Return the view used without a network."""
        grey, column = np.zeros((1, 1), np.uint8), np.zeros(1, np.int32)
        cells, part = np.zeros((4, 2, 2), np.float32), np.zeros(1, np.float32)
        return cls(cells, grey, column, part, ErrorModel.none(), np.float32(1.0), False)


@helper(fastmath={"nsz", "contract"})
def upsample_row(view: NetworkView, v: int, row: Float32Array, out: Float32Array) -> None:
    """Compute the network's view of row `v` of the photo into the first rows of `out` (3+, W): inverse depth, 1/m, NaN
    where unknown, and the maximum and minimum among neighbours. `row`: (4, w) work array."""
    cells, grey, columns, parts = view.cells, view.grey, view.columns, view.parts
    # The row of cells above row `v` of the photo, and how far that lies towards the next.
    at = (v + 0.5) * (cells.shape[1] / grey.shape[0]) - 0.5
    top = min(max(int(np.floor(at)), 0), cells.shape[1] - 2)
    down = np.float32(min(max(at - top, 0.0), 1.0))
    for k in range(4):
        above, below, between = cells[k, top], cells[k, top + 1], row[k]
        for x in range(cells.shape[2]):
            between[x] = above[x] + down * (below[x] - above[x])
    gain, offset, near, back = row[0], row[1], row[2], row[3]
    value, nearest, farthest, tones = out[0], out[1], out[2], grey[v]
    for u in range(grey.shape[1]):
        x, part = columns[u], parts[u]
        g = gain[x] + part * (gain[x + 1] - gain[x])
        y = offset[x] + part * (offset[x + 1] - offset[x]) + g * np.float32(tones[u])
        n = near[x] + part * (near[x + 1] - near[x])
        f = back[x] + part * (back[x + 1] - back[x])
        # Not min and max: NaN has to stay.
        y = n if y > n else y
        value[u] = f if y < f else y
        nearest[u] = n
        farthest[u] = f
