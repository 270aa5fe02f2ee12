"""Find bars, captions and frames along the edges of an image, and fill what hides the scene from its surroundings.

A bar has one background colour, letters or not, and ends in a straight sharp step over the whole width. A dark slope,
a night sky or white fog has the one colour, but no such step."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array

_SAMPLED = 320  # number of positions along a bar at which its colour is compared
_BLOCK = 48  # number of rows that are compared at a time
_MOST_HIDDEN = 0.5  # share of the image above which what looks like bars is the scene
_NESTED = 4  # maximum number of bars inside one another
_THINNEST = 4  # minimum thickness of a bar in pixels
_WIDEST, _WIDEST_BLACK, _WIDEST_BESIDE = 0.15, 0.25, 0.38  # maximum share of the side; level horizons are straight, too
_BLACK = 24
_BACKGROUND = 0.6  # minimum share of a bar, and of its last row, that has its colour
_LETTERS = 0.25  # minimum share of a row of letters that has the bar's colour
_STRAIGHT = 0.7  # minimum share of the bar's length on which it ends within three rows
_TIGHT, _LOOSE = 5.0, 14.0  # grey levels of one colour: if the scene is alike, and after strong compression
_DRIFT = 3.0  # maximum change of a bar's colour over its rows, or a tenth of the step at its end; skies have more
_PENUMBRA = 2  # pixels by which a bar is enlarged, because compression mixes its edge with the scene
_WORKING_WIDTH = 320  # width at which holes are filled, because the filling is smooth


def find_overlay(picture: UInt8Array) -> BoolArray | None:
    """Return (H, W) bool, True on bars, captions and frames along the edges of an image, or None."""
    height, width = picture.shape[:2]
    hidden = np.zeros((height, width), np.uint8)
    inner, clear = picture, hidden
    for _ in range(_NESTED):
        before = inner.shape
        for beside in (True, False, True, False):
            inner, clear = np.rot90(inner), np.rot90(clear)
            thick = _bar(inner, beside)
            clear[:thick] = 1
            inner, clear = inner[thick:], clear[thick:]
        if inner.shape == before:
            break
    if not 0.0 < hidden.mean() < _MOST_HIDDEN:
        return None
    grown = cv2.dilate(hidden, np.ones((2 * _PENUMBRA + 1,) * 2, np.uint8))
    return np.asarray(grown > 0)


def scene_of(picture: UInt8Array) -> UInt8Array:
    """Return an image (H, W, 3) RGB without its bars and frames, filled as `fill_hidden` does."""
    overlay = find_overlay(picture)
    return picture if overlay is None else fill_hidden(picture, overlay)


def _bar(image: NDArray[Any], beside: bool) -> int:
    """Return the rows of the bar along the upper edge of an image (h, w, 3), or 0. `beside`: the image is turned."""
    rows, columns = image.shape[:2]
    if min(rows, columns) < 4 * _THINNEST:
        return 0
    step = max(1, columns // _SAMPLED)
    outer = image[1, ::step]  # the outermost row may be mixed with what was beyond it
    colour = np.median(outer, axis=0).astype(np.uint8)
    outermost = _off(outer[None], colour)
    if (outermost <= _LOOSE).mean() < _BACKGROUND:
        return 0
    widest = round((_WIDEST_BESIDE if beside else _WIDEST_BLACK if colour.max() <= _BLACK else _WIDEST) * rows)
    # From the edge inwards, no further than the colour reaches.
    blocks: list[UInt8Array] = []
    for begin in range(1, widest, _BLOCK):
        blocks.append(_off(image[begin : begin + _BLOCK, ::step], colour))
        if len(blocks[-1]) <= 4 or ((blocks[-1][:-4] <= _LOOSE).mean(axis=1) < _LETTERS).any():
            break
    off = np.concatenate(blocks)[: widest + 3]  # a step is seen over three rows
    for tolerance in (_LOOSE, max(_TIGHT, 3 * float(np.percentile(outermost, 75)) + 3)):
        thick = _thickness(off, tolerance)
        if thick:
            apart = (image[1:thick, ::step].astype(np.int16) - colour) * (off[: thick - 1] <= tolerance)[..., None]
            drift = np.percentile(np.abs(apart.mean(axis=1)).max(axis=1), 80)
            if drift <= max(_DRIFT, 0.1 * float(np.median(off[min(thick + 1, len(off) - 1)]))):
                return thick
    return 0


def _thickness(off: UInt8Array, tolerance: float) -> int:
    """Return the rows up to a straight step; `off` (n, w) is the difference from the colour from the second row on."""
    same = off <= tolerance
    share = same.mean(axis=1)
    ends = (same[:-3] & (off[3:] > 1.5 * tolerance)).mean(axis=1) / np.maximum(share[:-3], 1e-6)
    steps = (ends >= _STRAIGHT) & (share[:-3] >= _BACKGROUND)
    if not steps.any():
        return 0
    first = int(np.argmax(steps))
    last = first + int(np.argmin(share[first : first + 4] >= _BACKGROUND))
    enough = share[:last].min() >= _LETTERS and share[:last].mean() >= _BACKGROUND
    return last + 1 if enough and last >= _THINNEST else 0


def _off(pixels: NDArray[Any], colour: UInt8Array) -> UInt8Array:
    """Return the largest difference from a colour in any channel, (h, w) of pixels (h, w, 3)."""
    red, green, blue = cv2.split(np.ascontiguousarray(pixels))
    off = [cv2.absdiff(plane, float(level)) for plane, level in zip((red, green, blue), colour, strict=True)]
    return np.asarray(cv2.max(cv2.max(off[0], off[1]), off[2]), np.uint8)


def fill_hidden(picture: UInt8Array, hidden: BoolArray) -> UInt8Array:
    """Return an image (H, W, 3) RGB without what hides the scene, `hidden` (H, W) bool: rows and columns at its edges
    show the scene mirrored, and holes the smooth continuation of what surrounds them."""
    if hidden.all():
        return picture
    (top, bottom), (left, right) = (np.flatnonzero(~hidden.all(axis=axis))[[0, -1]].tolist() for axis in (1, 0))
    bottom, right = bottom + 1, right + 1
    inner, holes = picture[top:bottom, left:right], hidden[top:bottom, left:right]
    if holes.any():
        inner = _without_holes(inner, holes)
    height, width = hidden.shape
    borders = top, height - bottom, left, width - right
    return np.asarray(cv2.copyMakeBorder(inner, *borders, cv2.BORDER_REFLECT), np.uint8)


def _without_holes(image: UInt8Array, holes: BoolArray) -> UInt8Array:
    """Fill the `holes` (h, w) of an image (h, w, 3) from means over ever larger surroundings."""
    height, width = holes.shape
    # A whole factor, at which OpenCV reduces three times as fast.
    factor = max(1, round(width / _WORKING_WIDTH))
    pad = 0, -height % factor, 0, -width % factor, cv2.BORDER_REPLICATE
    covered = cv2.copyMakeBorder(np.where(holes, np.uint8(255), np.uint8(0)), *pad)
    size = covered.shape[1] // factor, covered.shape[0] // factor
    known = (cv2.resize(covered, size, interpolation=cv2.INTER_AREA) == 0).astype(np.float32)
    values = cv2.resize(cv2.copyMakeBorder(image, *pad), size, interpolation=cv2.INTER_AREA) * known[..., None]
    levels: list[tuple[Float32Array, Float32Array]] = [(values, known)]
    while known.min() < 1 and max(known.shape) > 1:
        values, known = cv2.pyrDown(values), cv2.pyrDown(known)
        more = np.minimum(4 * known, 1) / np.maximum(known, 1e-6)  # a quarter known is enough
        values, known = values * more[..., None], known * more
        levels.append((values, known))
    filled = values / np.maximum(known, 1e-6)[..., None]
    for values, known in levels[-2::-1]:
        coarse = cv2.pyrUp(filled, dstsize=known.shape[::-1])
        filled = values + (1 - known)[..., None] * coarse
    rounded = np.clip(np.rint(filled), 0, 255).astype(np.uint8)
    smooth = cv2.resize(rounded, covered.shape[::-1])[:height, :width]
    return np.asarray(cv2.copyTo(smooth, covered[:height, :width], np.array(image)), np.uint8)
