"""A small image brought to a photo's size with the photo's edges.

Source: He and Sun, Fast Guided Filter, arXiv:1505.00996 (2015): in each window the small image is taken as a line of
the photo's grey values; gain and offset vary slowly, so they can be enlarged bilinearly and applied at full size.
"""

from __future__ import annotations

import cv2
import numpy as np

from ltm_core.depth.fusion_config import UpsamplingConfig
from ltm_core.types import Float32Array, UInt8Array


def guided_coefficients(
    image: Float32Array, grey: UInt8Array, config: UpsamplingConfig
) -> tuple[Float32Array, Float32Array]:
    """Gain and offset (h, w) so that `image` is gain * grey + offset with the edges of `grey` (H, W), 0..255.

    NaN in `image` spreads by twice the windows' radius.
    """
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
