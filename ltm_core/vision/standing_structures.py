"""Finds what stands before the sky and never moves: masts, poles, dishes, brackets of the camera's own tower.

Thin or hard-edged in every frame, where clouds change from frame to frame, and above the skyline. Where the camera's
pose is known, the skyline is the terrain's: what is not sky above it is nearer than any terrain there can be. Without,
it is that of the labels, without its narrow peaks.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.ndimage import median_filter

from ltm_core.base.types import BoolArray, Float32Array, Float64Array, UInt8Array

_REACH = 0.035
"""Of the width: structures that are this wide or less stand out from their surroundings in a top-hat."""
_CONTRAST = 9.0
"""Units of Lab's L by which a structure stands out in the weakest frame."""
_SMOOTH = 0.2
"""Of the width: peaks of the labels' skyline that are narrower than half of it are no terrain."""
_MARGIN = 0.012
"""Of the height, above the skyline, where nothing is proposed."""
_LEAST_TALL = 0.035
"""Of the height: smaller things are left."""
_WIDEST = 0.25
_LEAST_SOLID = 0.25
"""Share of what is proposed that stands out by itself."""


def labelled_skyline(sky: Sequence[BoolArray]) -> Float64Array:
    """(W,) rows where the sky (H, W) of the labels ends, in any frame, without narrow peaks."""
    ever = np.logical_or.reduce(list(sky))
    height, width = ever.shape
    lowest = np.where(ever.any(axis=0), height - np.argmax(ever[::-1], axis=0), 0).astype(np.float64)
    return np.asarray(median_filter(lowest, size=max(3, round(_SMOOTH * width)), mode="nearest"), np.float64)


def standing_structures(
    frames: Sequence[UInt8Array],
    sky: Sequence[BoolArray],
    skyline: Float64Array,
    excluded: BoolArray | None = None,
) -> list[BoolArray]:
    """(H, W) each, of pictures (H, W, 3) RGB some 640 pixels wide, the labels' sky (H, W) in each, and the (W,) rows of
    the skyline. `excluded`: what is masked for another reason."""
    height, width = sky[0].shape
    stands = np.minimum.reduce([_stands_out(frame) for frame in frames]) > _CONTRAST
    rows = np.arange(height)[:, None]
    above = rows < skyline[None] - _MARGIN * height
    if excluded is not None:
        above &= cv2.dilate(excluded.astype(np.uint8), np.ones((7, 7), np.uint8)) == 0
    covered = ~np.logical_or.reduce(list(sky))
    # A lattice is closed; a wire is not kept.
    size = max(3, round(0.014 * width))
    seeds = (above & (stands | (covered & _near(stands, size)))).astype(np.uint8)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    closed = cv2.morphologyEx(seeds, cv2.MORPH_CLOSE, disc) & above.astype(np.uint8)
    opened = cv2.morphologyEx(closed, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    count, parts, stats, _ = cv2.connectedComponentsWithStats(opened, connectivity=8)
    found = []
    for k in range(1, count):
        part = parts == k
        tall, wide = stats[k, cv2.CC_STAT_HEIGHT], stats[k, cv2.CC_STAT_WIDTH]
        if tall < _LEAST_TALL * height or wide > _WIDEST * width or tall < 0.8 * wide:
            continue
        if float(stands[part].mean()) < _LEAST_SOLID:
            continue
        found.append(_down_to_its_foot(part, stands, size))
    return found


def _near(mask: BoolArray, size: int) -> BoolArray:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((size, size), np.uint8)) > 0)


def _stands_out(frame: UInt8Array) -> Float32Array:
    """(H, W): how much darker or brighter than all about it, in L."""
    light = cv2.cvtColor(frame, cv2.COLOR_RGB2LAB)[..., 0]
    size = 2 * round(_REACH * frame.shape[1] / 2) + 1
    across = np.ones((1, size), np.uint8)
    dark = cv2.morphologyEx(light, cv2.MORPH_BLACKHAT, across)
    bright = cv2.morphologyEx(light, cv2.MORPH_TOPHAT, across)
    return np.asarray(np.maximum(dark, bright), np.float32) * np.float32(100 / 255)


def _down_to_its_foot(part: BoolArray, stands: BoolArray, size: int) -> BoolArray:
    """Further down, below the skyline, as long as it goes on in the columns of its foot."""
    whole = part.copy()
    bottom = int(np.flatnonzero(part.any(axis=1))[-1])
    foot = np.flatnonzero(part[max(0, bottom - size) : bottom + 1].any(axis=0))
    left, right = max(0, int(foot[0]) - 2), min(part.shape[1], int(foot[-1]) + 3)
    missing = 0
    for row in range(bottom + 1, part.shape[0]):
        here = np.flatnonzero(stands[row, left:right])
        missing = missing + 1 if len(here) < 2 or (here[-1] - here[0]) < 0.4 * (right - left) else 0
        if missing > size:
            break
        if missing == 0:
            whole[bottom + 1 : row + 1, left:right] = True
    return whole
