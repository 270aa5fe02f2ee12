"""Finds captions that a camera writes into its pictures: rows of letters along the upper or lower edge, in all frames.

The text changes with the time, the strip does not. Above and below it the picture is quiet; over the texture of near
ground a caption cannot be told, and none is proposed.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Float64Array, UInt8Array

_STRIP = 0.08
"""Of the height, at either edge, in which captions are looked for."""
_STROKE = 28
"""Grey levels by which a stroke differs from its surroundings, in any channel."""
_LEAST_ROW = 0.012
"""Share of a row that is strokes."""
_QUIET = 0.3
"""Times a caption's mean row, that the rows beside it may have at most."""
_TALLEST = 0.06
_LEAST_FRAMES = 0.6


def caption_strips(frames: Sequence[UInt8Array]) -> list[BoolArray]:
    """(H, W) each, of pictures (H, W, 3) RGB of one camera at their own size."""
    height, width = frames[0].shape[:2]
    rows = max(8, round(_STRIP * height))
    strips = []
    for top in (True, False):
        part = slice(0, rows) if top else slice(height - rows, height)
        found = [_band(_strokes(frame[part]), height) for frame in frames]
        there = [band for band in found if band is not None]
        if len(there) < _LEAST_FRAMES * len(frames) or not there:
            continue
        first, last = (int(np.median([band[k] for band in there])) for k in (0, 1))
        left, right = min(band[2] for band in there), max(band[3] for band in there)
        margin = max(2, round(0.4 * (last - first + 1)))  # tails of letters are few
        hidden = np.zeros((height, width), np.bool_)
        above = part.start + first - margin
        hidden[max(0, above) : part.start + last + 1 + margin, max(0, left - 2 * margin) : right + 1 + 2 * margin] = (
            True
        )
        strips.append(hidden)
    return strips


def _strokes(strip: UInt8Array) -> BoolArray:
    size = 2 * max(3, round(0.006 * strip.shape[1])) + 1
    padded = cv2.copyMakeBorder(strip, size, size, 0, 0, cv2.BORDER_REFLECT)
    around = cv2.medianBlur(padded, size)[size:-size]
    return np.asarray(cv2.absdiff(strip, around).max(axis=2) > _STROKE)


def _band(strokes: BoolArray, height: int) -> tuple[int, int, int, int] | None:
    """First and last row, first and last column of the letters, where there are any."""
    share: Float64Array = strokes.mean(axis=1)
    busy = share > _LEAST_ROW
    if not busy.any():
        return None
    # The longest run of busy rows, small gaps (between a letter's strokes) closed.
    gap = max(1, round(0.003 * height))
    closed = cv2.morphologyEx(busy.astype(np.uint8)[:, None], cv2.MORPH_CLOSE, np.ones((2 * gap + 1, 1), np.uint8))
    rows = np.asarray(closed).ravel()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], rows, [0]])))
    runs = edges.reshape(-1, 2)
    first, end = max(runs, key=lambda run: share[run[0] : run[1]].sum())
    tall = end - first
    if not 4 <= tall <= _TALLEST * height:
        return None
    inside = float(share[first:end].mean())
    beside = np.concatenate([share[max(0, first - tall) : max(0, first - 1)], share[end + 1 : end + tall]])
    if len(beside) < tall // 2 or float(beside.mean()) > _QUIET * inside:
        return None
    columns = np.flatnonzero(strokes[first:end].any(axis=0))
    # Letters follow each other: most of the width between the first and the last is not empty.
    spread = int(columns[-1]) - int(columns[0]) + 1
    written = np.asarray(strokes[first:end].any(axis=0), np.uint8)[None]
    filled = np.asarray(cv2.dilate(written, np.ones((1, 2 * tall + 1), np.uint8))).ravel()
    if spread < 4 * tall or float(filled[columns[0] : columns[-1] + 1].mean()) < 0.8:
        return None
    return int(first), int(end - 1), int(columns[0]), int(columns[-1])
