"""Brings a photo to the tensor that a network of a manifest takes."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ltm_core.types import UInt8Array
from ltm_core.vision.manifest import InputSpec


def input_tensor(image: UInt8Array, spec: InputSpec) -> npt.NDArray[Any]:
    """Photo (H, W, 3) uint8 RGB -> the tensor that a network takes, resized without keeping the aspect."""
    return as_tensor(fitted(image, spec), spec)


def fitted(image: UInt8Array, spec: InputSpec) -> UInt8Array:
    """Photo (H, W, 3) uint8 RGB in the network's size. Shrinks by area (no aliasing), enlarges bilinearly."""
    height, width = image.shape[:2]
    if (width, height) == (spec.width, spec.height):
        return image
    shrinks = spec.width <= width and spec.height <= height
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, (spec.width, spec.height), interpolation=method), np.uint8)


def as_tensor(image: UInt8Array, spec: InputSpec) -> npt.NDArray[Any]:
    """Photo (height, width, 3) uint8 RGB of the network's size -> the tensor that it takes."""
    if spec.channels == "bgr":
        image = image[..., ::-1]
    planar = spec.layout == "NCHW"
    tensor: npt.NDArray[Any] = np.moveaxis(image, -1, 0) if planar else image
    if spec.dtype == "uint8":
        return np.ascontiguousarray(tensor[None])
    std = np.asarray(spec.std, dtype=np.float32)
    factor = np.float32(spec.scale) / std
    offset = np.asarray(spec.mean, dtype=np.float32) / std
    tensor = np.array(tensor, np.float32, order="C")
    by_channel = (3, 1, 1) if planar else (3,)
    tensor *= factor.reshape(by_channel)
    tensor -= offset.reshape(by_channel)
    return tensor[None]
