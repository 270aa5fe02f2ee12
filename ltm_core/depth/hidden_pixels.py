"""Pixels of a photo in which the terrain is not seen: a mast, a caption, the lens's corners. They have no depth.

Inside them the photo says nothing of the terrain, so nothing is compared, sampled or measured there.
"""

from __future__ import annotations

import cv2
import numpy as np

from ltm_core.depth.depth_discontinuities import DepthDiscontinuities
from ltm_core.types import BoolArray, Float32Array, UInt8Array
from ltm_core.vision.labels import UNLABELLED


def labels_behind(hidden: BoolArray, labels: UInt8Array, ground: Float32Array, sky: int) -> UInt8Array:
    """Labels (H, W) with what the terrain lets expect behind hidden pixels (H, W): sky where no ground is traced.

    So a mast before the sky is no land on the skyline, and a corner of the lens does not end the sky of its column.
    """
    behind = np.where(np.isfinite(ground), np.uint8(UNLABELLED), np.uint8(sky))
    return np.asarray(np.where(hidden, behind, labels), np.uint8)


def edges_seen(edges: DepthDiscontinuities, hidden: BoolArray) -> DepthDiscontinuities:
    """Without those that hidden pixels (H, W) cover, and those that are the hidden area's own border."""
    above = np.maximum(edges.rows - 1, 0)
    seen = ~(hidden[edges.rows, edges.cols] | hidden[above, edges.cols])
    return DepthDiscontinuities(edges.rows[seen], edges.cols[seen], edges.jump)


def hidden_at(hidden: BoolArray, height: int, width: int) -> BoolArray:
    """`hidden` (H, W) at another size, edge to edge: True where any of what a pixel there covers is hidden."""
    if hidden.shape == (height, width):
        return hidden
    shrinks = height <= hidden.shape[0] and width <= hidden.shape[1]
    method = cv2.INTER_AREA if shrinks else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(hidden.astype(np.float32), (width, height), interpolation=method) > 0, np.bool_)
