"""A second, coarser look at the whole picture: its scores of land are averaged with those of the first.

At half the size a slope is an object of half as many pixels: what the network sees of its surroundings doubles, and
noise and the traces of compression are gone. On photographs the two looks err in other places, so the mean is right
more often, and is less sure where they differ. A quarter of the pixels, a quarter of the work.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from ltm_core.types import BoolArray, Float32Array

_CREST: Final = 0.0125  # of the width


def with_coarse_look(scores: Float32Array, coarse: Float32Array, share: float, sky: Sequence[int]) -> Float32Array:
    """Scores (K, h, w) of a picture, those of its land averaged with `coarse` (K, h', w'), which counts by `share`.

    Classes `sky` stay as probable as they were, and the crest below them keeps its classes: both are fine, and tell
    cameras their pose.
    """
    height, width = scores.shape[1:]
    land = [k for k in range(len(scores)) if k not in sky]
    enlarged = np.stack([cv2.resize(coarse[k], (width, height), interpolation=cv2.INTER_LINEAR) for k in land])
    own = _log_sum(scores[land])
    weight = np.full((height, width), share, np.float32)
    if sky:
        weight *= _beyond_crest(_log_sum(scores[list(sky)]) > own)
    mean = np.asarray(scores[land] + weight * (enlarged - scores[land]), np.float32)
    mixed = scores.copy()
    mixed[land] = mean + (own - _log_sum(mean))
    return mixed


def _beyond_crest(sky: BoolArray) -> Float32Array:
    """(h, w) 0 within `_CREST` below the lowest sky (h, w) of each column, 1 from twice as far on, and above."""
    rows, cols = sky.shape
    lowest = np.where(sky.any(axis=0), rows - 1 - np.argmax(sky[::-1], axis=0), -np.inf)
    reach = max(1.0, _CREST * cols)
    below = (np.arange(rows)[:, None] - lowest) / reach
    return np.where(below <= 0, 1.0, np.clip(below - 1.0, 0.0, 1.0)).astype(np.float32)


def _log_sum(scores: Float32Array) -> Float32Array:
    """log(sum(exp)) over the classes, (h, w); `np.logaddexp.reduce` takes twelve times as long, thrice a frame."""
    most = scores.max(axis=0)
    return np.asarray(most + np.log(np.exp(scores - most).sum(axis=0)), np.float32)
