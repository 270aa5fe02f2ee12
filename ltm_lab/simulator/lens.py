"""Lens distortion: scenes are rendered through a larger pinhole and resampled along the lens's rays."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import Float32Array
from ltm_core.geometry.camera import Camera


def pinhole_for(camera: Camera, finer: float = 1.0) -> Camera:
    """The undistorted camera that sees all that `camera` sees, with pixels `finer` times as fine as at its centre."""
    rays = camera.rays()
    x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
    f = camera.fx * finer
    left, top = float(-x.min() * f) + 2, float(-y.min() * f) + 2
    width, height = int(np.ceil(left + x.max() * f + 3)), int(np.ceil(top + y.max() * f + 3))
    return Camera(width, height, f, f, left, top)


def lookup(camera: Camera, pinhole: Camera) -> tuple[Float32Array, Float32Array]:
    """Where each pixel of `camera` lies in the image of `pinhole`: columns and rows, (H, W) each."""
    rays = camera.rays()
    u = pinhole.fx * rays[..., 0] / rays[..., 2] + pinhole.cx
    v = pinhole.fy * rays[..., 1] / rays[..., 2] + pinhole.cy
    return u.astype(np.float32), v.astype(np.float32)


def through(image: NDArray[Any], maps: tuple[Float32Array, Float32Array], smooth: bool) -> NDArray[Any]:
    """An image of the pinhole as the lens shows it; `smooth`: interpolated, else the nearest pixel's value."""
    if smooth:
        return np.asarray(cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR))
    rows = np.clip(np.rint(maps[1]).astype(int), 0, image.shape[0] - 1)
    return np.asarray(image[rows, np.clip(np.rint(maps[0]).astype(int), 0, image.shape[1] - 1)])
