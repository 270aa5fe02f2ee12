"""Brings a photo to the tensor that a network of a manifest takes."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ltm_core.types import UInt8Array
from ltm_core.vision.manifest import InputSpec


def input_tensor(image: UInt8Array, spec: InputSpec) -> npt.NDArray[Any]:
    """Photo (H, W, 3) uint8 RGB -> the tensor that a network takes, resized without keeping the aspect.

    Shrinks by area (no aliasing), enlarges bilinearly.
    """
    height, width = image.shape[:2]
    if (width, height) != (spec.width, spec.height):
        shrinks = spec.width <= width and spec.height <= height
        method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        image = np.asarray(cv2.resize(image, (spec.width, spec.height), interpolation=method), dtype=np.uint8)
    if spec.channels == "bgr":
        image = image[..., ::-1]
    tensor: npt.NDArray[Any] = image
    if spec.dtype == "float32":
        std = np.asarray(spec.std, dtype=np.float32)
        factor = np.float32(spec.scale) / std
        offset = np.asarray(spec.mean, dtype=np.float32) / std
        tensor = image.astype(np.float32) * factor - offset
    if spec.layout == "NCHW":
        tensor = np.moveaxis(tensor, -1, 0)
    return np.ascontiguousarray(tensor[None])
