"""A second, coarser look at the whole picture: its scores of land are averaged with those of the first.

At half the size a slope is an object of half as many pixels: what the network sees of its surroundings doubles, and
noise and the traces of compression are gone. On photographs the two looks err in other places, so the mean is right
more often, and is less sure where they differ. A quarter of the pixels, a quarter of the work.
"""

from __future__ import annotations

from collections.abc import Collection

import cv2
import numpy as np

from ltm_core.types import Float32Array


def with_coarse_look(scores: Float32Array, coarse: Float32Array, share: float, sky: Collection[int]) -> Float32Array:
    """Scores (K, h, w) of a picture, those of its land averaged with `coarse` (K, h', w'), which counts by `share`.

    Classes `sky` stay as probable as they were: the skyline, by which cameras find their pose, is fine.
    """
    height, width = scores.shape[1:]
    land = [k for k in range(len(scores)) if k not in sky]
    enlarged = np.stack([cv2.resize(coarse[k], (width, height), interpolation=cv2.INTER_LINEAR) for k in land])
    mean = scores[land] + np.float32(share) * (enlarged - scores[land])
    mixed = scores.copy()
    mixed[land] = mean + (_log_sum(scores[land]) - _log_sum(mean))
    return mixed


def _log_sum(scores: Float32Array) -> Float32Array:
    """log(sum(exp)) over the classes, (h, w)."""
    most = scores.max(axis=0)
    return np.asarray(most + np.log(np.exp(scores - most).sum(axis=0)), np.float32)
