"""Smooth random fields and soft edges, used by the data augmentation."""

from __future__ import annotations

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array


def fractal_noise(
    size: tuple[int, int], rng: np.random.Generator, coarsest: int = 4, octaves: int = 5, fall: float = 0.55
) -> Float32Array:
    """Smooth noise (H, W) in 0..1: `octaves` grids of random values, each twice as fine and `fall` times as strong."""
    height, width = size
    total = np.zeros(size, np.float32)
    for octave in range(octaves):
        cells = coarsest * 2**octave
        grid = rng.random((max(2, cells * height // width), cells), dtype=np.float32)
        total += np.float32(fall**octave) * np.asarray(cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC))
    low, high = total.min(), total.max()
    return np.asarray((total - low) / max(float(high - low), 1e-6), np.float32)


def soft_mask(mask: BoolArray) -> Float32Array:
    """A mask with its edge softened over about two pixels, as a lens would; (H, W, 1)."""
    return np.asarray(cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 0.7), np.float32)[..., None]
