"""Propose areas for a camera's mask from several of its images: lens corners and captions.

A caption is a row of letters along the upper or lower edge in all images. The text changes with the time, the strip
does not. The image above and below it must be smooth: over the texture of near ground no caption is proposed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, Float64Array, UInt8Array
from ltm_core.vision.areas import ERASED, NamedArea
from ltm_core.vision.lens_corners import lens_corners
from ltm_core.vision.masks import fill

WORKING_WIDTH = 640
MOST_FRAMES = 24
"""Number of images that are read; more images change no proposal."""

_STRIP = 0.08
"""Share of the height, at either edge, in which captions are searched."""
_STROKE = 28
"""Grey levels by which a stroke differs from its surroundings in any channel."""
_LEAST_ROW = 0.012
"""Minimum share of a row that is strokes."""
_QUIET = 0.3
"""Maximum of the rows beside a caption, in multiples of the caption's mean row."""
_TALLEST = 0.06
_LEAST_FRAMES = 0.6


@dataclass(frozen=True, eq=False)
class Proposal:
    """`hidden`: (H, W) bool at the images' size. `kind`: lens, caption, or the class of a drawn area."""

    kind: str
    hidden: BoolArray
    reason: str


def propose_mask(frames: Sequence[UInt8Array]) -> list[Proposal]:
    """Propose areas to mask in images (H, W, 3) RGB of one fixed camera; images in different light work best.

    The result is deterministic. Raises ImageError if the images differ in size or if there are none.
    """
    shape = _common_shape(frames)
    height, width = shape
    small_width = min(WORKING_WIDTH, width)
    size = small_width, max(1, round(height * small_width / width))
    small = [np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), np.uint8) for frame in frames]
    count = "1 frame" if len(frames) == 1 else f"{len(frames)} frames"
    found = [
        Proposal("lens", _at(corner.hidden, shape), f"smooth corner bounded by an arc, in {count}")
        for corner in lens_corners(small)
    ]
    return found + [
        Proposal("caption", strip, f"rows of letters in the same place, in {count}")
        for strip in _caption_strips(frames)
    ]


def drawn_proposals(areas: Sequence[NamedArea], names: Sequence[str], shape: tuple[int, int]) -> list[Proposal]:
    """Return drawn areas that hide the landscape, in order, at this image size (H, W): areas of no class of `names`,
    without what was drawn or erased over them later in the same image."""
    found: list[tuple[NamedArea, UInt8Array]] = []
    for area in areas:
        drawn = np.zeros(shape, np.uint8)
        fill(drawn, area.polygon)
        if area.kind != ERASED and area.kind not in names:
            found.append((area, drawn))
            continue
        for earlier, hidden in found:
            if earlier.image == area.image:
                hidden[drawn > 0] = 0
    return [Proposal(area.kind, h > 0, area.reason or "drawn by hand") for area, h in found if h.any()]


def _common_shape(frames: Sequence[UInt8Array]) -> tuple[int, int]:
    if not frames:
        raise ImageError("no images to propose a mask from")
    shapes = {frame.shape for frame in frames}
    if len(shapes) > 1:
        said = ", ".join(sorted(f"{shape[1]} x {shape[0]}" for shape in shapes))
        raise ImageError(f"the images have different sizes ({said}); give images of one camera only")
    return frames[0].shape[0], frames[0].shape[1]


def _at(hidden: BoolArray, shape: tuple[int, ...]) -> BoolArray:
    if hidden.shape == shape:
        return hidden
    resized = cv2.resize(hidden.astype(np.float32), shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(resized > 0.5, np.bool_)


def _caption_strips(frames: Sequence[UInt8Array]) -> list[BoolArray]:
    """Return (H, W) each, of images (H, W, 3) RGB of one camera at their own size."""
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
    """Return the first and last row, first and last column of the letters, where there are any."""
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
