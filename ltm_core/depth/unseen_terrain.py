"""Find pixels without traced terrain: hidden by structures, sky by the labels, and unknown regions."""

from itertools import pairwise

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array


def hidden_at(hidden: BoolArray, height: int, width: int) -> BoolArray:
    """Return `hidden` (H, W) at another size, edge to edge: True if any of the area of a pixel is hidden."""
    if hidden.shape == (height, width):
        return hidden
    shrinks = height <= hidden.shape[0] and width <= hidden.shape[1]
    method = cv2.INTER_AREA if shrinks else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(hidden.astype(np.float32), (width, height), interpolation=method) > 0, np.bool_)


def with_labelled_sky(depth: Float32Array, labels: UInt8Array, sky: int) -> Float32Array:
    """Return the traced depth (H, W) with +inf for NaN where `labels` (H, W) are sky; unchanged depth is returned
    itself."""
    unknown = np.isnan(depth)
    if not unknown.any():
        return depth
    open_sky = (labels == sky) & ~(depth < np.inf)
    for above, here in pairwise(open_sky):  # whole rows: `logical_and.accumulate` takes longer
        here &= above
    unknown &= open_sky
    if not unknown.any():
        return depth
    result = depth.copy()
    result[unknown] = np.inf
    return result


def clear_unenclosed(ground: Float32Array, depth: Float32Array, sigma: Float32Array, source: UInt8Array) -> None:
    """Make unknown in `depth`, `sigma` (H, W) and `source` what regions of NaN in the traced `ground` (H, W) cover that
    touch sky or the image's edge, by a corner or more: land beyond the DEM, where a network's scale is not known."""
    unknown = np.isnan(ground)
    gone = unknown & (source != 0)
    if not gone.any():
        return
    count, regions = cv2.connectedComponents(unknown.view(np.uint8), connectivity=8)
    beside = cv2.dilate((ground == np.inf).view(np.uint8), np.ones((3, 3), np.uint8)) > 0
    beside[[0, -1]] = beside[:, [0, -1]] = True
    open_ended = np.zeros(count, np.bool_)
    open_ended[regions[beside & unknown]] = True
    if not open_ended[1:].all():
        gone &= open_ended[regions]
    depth[gone] = sigma[gone] = np.float32(np.nan)
    source[gone] = 0


_MOST_UNKNOWN = 0.5
"""Share of unknown pixels above which a photo is reported as mostly unknown."""
_EVERY = 4  # pixels looked at, each way


def mostly_unknown(depth: Float32Array) -> str:
    """Return why most of ranges or depths (H, W; finite, +inf sky, NaN unknown) are unknown, with the share; empty if
    they are not. Every fourth pixel each way is used."""
    part = depth[::_EVERY, ::_EVERY]
    unknown, known = np.isnan(part), np.isfinite(part)
    if unknown.mean() <= _MOST_UNKNOWN:
        return ""
    above = np.logical_or.accumulate(known, axis=0)
    below = np.logical_or.accumulate(known[::-1], axis=0)[::-1]
    reasons = {
        "the view extends beyond the DEM's edge; give a coarser DEM around it, or possible_ground": below & ~above,
        "the DEM has holes there": below & above,
        "the camera is beyond the DEM's edge or next to a hole": ~below & above,
        "the view misses the DEM; check position and azimuth, or give a larger DEM": ~below & ~above,
    }
    likely = max(reasons, key=lambda reason: int((unknown & reasons[reason]).sum()))
    return f"{unknown.mean():.0%} of the image is unknown ground: {likely}"
