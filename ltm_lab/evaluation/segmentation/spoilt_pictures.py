"""Clear photos spoilt on purpose, one way at a time, for scoring what is told of usable pictures."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.vision.usable import Unusable

WAYS: dict[str, Unusable] = {
    "night, 12 % of the light": Unusable.NIGHT,
    "night, 6 %": Unusable.NIGHT,
    "fog, 80 % of the light is its own": Unusable.FOG,
    "fog, 90 %": Unusable.FOG,
    "fog, 95 %": Unusable.FOG,
    "glare, exposed 3 times": Unusable.GLARE,
    "glare, exposed 5 times": Unusable.GLARE,
    "blur, 0.5 % of the width": Unusable.BLUR,
    "blur, 1 %": Unusable.BLUR,
    "blank": Unusable.BLANK,
}
"""What is done to a photo, and what should be said of it."""


def spoilt(photo: UInt8Array, way: str, seed: int = 0) -> UInt8Array:
    """A photo (H, W, 3) spoilt in one of `WAYS`, with the noise of a sensor."""
    rng = np.random.default_rng(seed)
    light = _SPOIL[way](photo.astype(np.float32))
    return np.asarray(np.clip(light + rng.normal(0.0, 1.5, photo.shape), 0, 255), np.uint8)


def _blurred(photo: Float32Array, share: float) -> Float32Array:
    return np.asarray(cv2.GaussianBlur(photo, (0, 0), share * photo.shape[1]), np.float32)


_FOG = np.array([185.0, 188.0, 192.0], np.float32)
_SPOIL: dict[str, Callable[[Float32Array], Float32Array]] = {
    "night, 12 % of the light": lambda p: np.float32(0.12) * p,
    "night, 6 %": lambda p: np.float32(0.06) * p,
    "fog, 80 % of the light is its own": lambda p: np.float32(0.2) * p + np.float32(0.8) * _FOG,
    "fog, 90 %": lambda p: np.float32(0.1) * p + np.float32(0.9) * _FOG,
    "fog, 95 %": lambda p: np.float32(0.05) * p + np.float32(0.95) * _FOG,
    "glare, exposed 3 times": lambda p: np.float32(3.0) * p + np.float32(90.0),
    "glare, exposed 5 times": lambda p: np.float32(5.0) * p + np.float32(150.0),
    "blur, 0.5 % of the width": lambda p: _blurred(p, 0.005),
    "blur, 1 %": lambda p: _blurred(p, 0.01),
    "blank": lambda p: np.full_like(p, 96.0),
}
