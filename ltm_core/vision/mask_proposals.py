"""Propose areas for a camera's mask from several of its images: bars and frames, lens corners, captions.

A lens corner is covered by the hood: smooth, of one colour, bounded by an arc. In a single image a dark slope or a
piece of sky can look alike; over images in other light the hood alone keeps its edge.

A caption is a row of letters along the upper or lower edge in all images. The text changes with the time, the strip
does not. The image above and below it must be smooth: over the texture of near ground no caption is proposed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, UInt8Array
from ltm_core.vision.areas import ERASED, NamedArea
from ltm_core.vision.label_rules import cie_lab
from ltm_core.vision.masks import fill
from ltm_core.vision.overlays import fill_hidden, find_overlay

WORKING_WIDTH = 640
MOST_FRAMES = 24  # number of images that are read; more images change no proposal

_STRIP = 0.08  # share of the height, at either edge, in which captions are searched
_STROKE = 28  # grey levels by which a stroke differs from its surroundings in any channel
_LEAST_ROW = 0.012  # minimum share of a row that is strokes
_QUIET = 0.3  # maximum of the rows beside a caption, in multiples of the caption's mean row
_TALLEST = 0.06
_LEAST_FRAMES = 0.6

_PATCH = 0.02  # side of the square in the corner that gives the hood's colour, as a share of the width
_TOLERANCES = np.arange(5.0, 46.0, 2.0)  # of a hood's colour in CIE Lab; the one with the sharpest edge is used
_REACH = 0.5  # maximum width of a corner, as a share of the width
_LEAST_AREA, _MOST_AREA = 0.0015, 0.13  # minimum and maximum area, as a share of the image
_MOST_TEXTURE = 1.6  # maximum median local contrast (Lab L) in a hood; land has more, and JPEG noise less
_MOST_RESIDUAL = 0.014  # maximum mean distance between the edge and the arc, as a share of the width
_LEAST_EDGE = 0.9  # minimum mean gradient at the edge, CIE Lab per pixel at a width of 640; that of a cloud is lower
_PENUMBRA = 0.012  # width by which a corner is enlarged, as a share of the width, because a hood's edge is out of focus


@dataclass(frozen=True, eq=False)
class Proposal:
    """`hidden`: (H, W) bool at the images' size. `kind`: bar, lens, caption, or the class of a drawn area."""

    kind: str
    hidden: BoolArray
    reason: str


def propose_mask(frames: Sequence[UInt8Array]) -> list[Proposal]:
    """Propose areas to mask in images (H, W, 3) RGB of one fixed camera; images in different light work best. The
    result is deterministic. Raises ImageError if the images differ in size or if there are none."""
    shapes = sorted({(frame.shape[1], frame.shape[0]) for frame in frames})
    if len(shapes) != 1:
        named = ", ".join(f"{width} x {height}" for width, height in shapes) or "there are none"
        raise ImageError(f"the images have different sizes ({named}); give images of one camera only")
    (width, height), count = shapes[0], "1 frame" if len(frames) == 1 else f"{len(frames)} frames"
    there = [overlay for frame in frames if (overlay := find_overlay(frame)) is not None]
    found = []
    if len(there) >= _LEAST_FRAMES * len(frames):
        bars = np.asarray(np.mean(there, axis=0) > 0.5, np.bool_)
        found.append(Proposal("bar", bars, f"bar or frame of one colour with a straight edge, in {count}"))
        frames = [fill_hidden(frame, bars) for frame in frames]
    size = min(WORKING_WIDTH, width), max(1, round(height * min(WORKING_WIDTH, width) / width))
    small = [np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), np.uint8) for frame in frames]
    for corner in lens_corners(small):
        hidden = cv2.resize(corner.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.5
        found.append(Proposal("lens", np.asarray(hidden), f"smooth corner bounded by an arc, in {count}"))
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
        row, col = max(0, part.start + first - margin), max(0, left - 2 * margin)
        hidden[row : part.start + last + 1 + margin, col : right + 1 + 2 * margin] = True
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
    busy = (share > _LEAST_ROW).astype(np.uint8)[:, None]
    # The longest run of busy rows, small gaps (between a letter's strokes) closed.
    gap = max(1, round(0.003 * height))
    rows = np.ravel(cv2.morphologyEx(busy, cv2.MORPH_CLOSE, np.ones((2 * gap + 1, 1), np.uint8)))
    runs = np.flatnonzero(np.diff(np.concatenate([[0], rows, [0]]))).reshape(-1, 2)
    first, end = max(runs, key=lambda run: share[run[0] : run[1]].sum(), default=(0, 0))
    tall = end - first
    if not 4 <= tall <= _TALLEST * height:
        return None
    beside = np.concatenate([share[max(0, first - tall) : max(0, first - 1)], share[end + 1 : end + tall]])
    if len(beside) < tall // 2 or float(beside.mean()) > _QUIET * float(share[first:end].mean()):
        return None
    written = np.asarray(strokes[first:end].any(axis=0), np.uint8)
    columns = np.flatnonzero(written)
    left, right = int(columns[0]), int(columns[-1])
    # Letters follow each other: most of the width between the first and the last is not empty.
    filled = np.ravel(cv2.dilate(written[None], np.ones((1, 2 * tall + 1), np.uint8)))
    if right - left + 1 < 4 * tall or float(filled[left : right + 1].mean()) < 0.8:
        return None
    return int(first), int(end - 1), left, right


def lens_corners(frames: Sequence[UInt8Array]) -> list[BoolArray]:
    """Find lens corners (H, W) in images (H, W, 3) RGB of one camera, about 640 pixels wide; deterministic."""
    labs = [cie_lab(np.asarray(cv2.GaussianBlur(frame, (0, 0), 1.5), np.uint8)) for frame in frames]
    found = []
    for down in (1, -1):
        for right in (1, -1):  # flipped so that the corner is the top left one; flipped again it is as it was
            corner = _top_left([lab[::down, ::right] for lab in labs])
            if corner is not None:
                found.append(np.ascontiguousarray(corner[::down, ::right]))
    return found


def _top_left(labs: Sequence[Float32Array]) -> BoolArray | None:
    """Return the lens corner with the sharpest edge."""
    height, width = labs[0].shape[:2]
    side = max(3, round(_PATCH * width))
    # Distance from the hood's colour, gradient and texture: means of the frames.
    away, gradient, texture = (np.zeros((height, width), np.float32) for _ in range(3))
    for lab in labs:
        hood = np.median(lab[:side, :side].reshape(-1, 3), axis=0)
        away += np.linalg.norm(lab - hood, axis=2).astype(np.float32) / len(labs)
        across, down = cv2.Sobel(lab, cv2.CV_32F, 1, 0, ksize=3), cv2.Sobel(lab, cv2.CV_32F, 0, 1, ksize=3)
        gradient += np.sqrt((across**2 + down**2).sum(axis=2)) / (8 * len(labs))
        light = np.ascontiguousarray(lab[..., 0])
        texture += np.abs(light - cv2.GaussianBlur(light, (0, 0), 3.0)) / len(labs)
    corners = [c for t in _TOLERANCES if (c := _within(away < t, gradient, texture)) is not None]
    return max(corners, key=lambda corner: corner[1])[0] if corners else None


def _within(near: BoolArray, gradient: Float32Array, texture: Float32Array) -> tuple[BoolArray, float] | None:
    """Return the region of one colour in the top left corner, if it may be a hood, and the gradient at its edge."""
    height, width = near.shape
    # Letters on the hood are closed; thin bridges to the sky are cut.
    size = max(3, round(0.012 * width))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    padded = cv2.copyMakeBorder(near.astype(np.uint8), size, size, size, size, cv2.BORDER_REPLICATE)
    solid = cv2.morphologyEx(cv2.morphologyEx(padded, cv2.MORPH_CLOSE, disc), cv2.MORPH_OPEN, disc)
    solid = solid[size:-size, size:-size]
    _, parts = cv2.connectedComponents(solid, connectivity=4)
    if parts[0, 0] == 0:
        return None
    region = np.asarray(parts == parts[0, 0])
    area = float(region.mean())
    if not _LEAST_AREA < area < _MOST_AREA:
        return None
    rows, cols = np.flatnonzero(region.any(axis=1)), np.flatnonzero(region.any(axis=0))
    far = cols[-1] > _REACH * width or rows[-1] > 0.97 * height
    if far or float(np.median(texture[region])) > _MOST_TEXTURE:
        return None
    inner = cv2.erode(region.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) > 0
    edge = region & ~inner
    edge[-1], edge[:, -1] = False, False
    v, u = np.nonzero(edge)
    if len(u) < 10:
        return None
    # A circle through the edge, by least squares. The image's middle lies on its inner side, and it bends about it.
    matrix = np.column_stack([2 * u, 2 * v, np.ones(len(u))])
    x, y, rest = np.linalg.lstsq(matrix, (u**2 + v**2).astype(np.float64), rcond=None)[0].tolist()
    radius = math.sqrt(max(rest + x**2 + y**2, 0.0))
    residual = float(np.abs(np.hypot(u - x, v - y) - radius).mean())
    inside = math.hypot(width / 2 - x, height / 2 - y) < radius
    strength = float(gradient[edge].mean())
    if not inside or residual > _MOST_RESIDUAL * width or not 0.25 * width < radius < 3.0 * width:
        return None
    if strength < _LEAST_EDGE:
        return None
    all_rows, all_cols = np.mgrid[0:height, 0:width]
    beyond = np.hypot(all_cols - x, all_rows - y) > radius - _PENUMBRA * width
    window = (all_rows <= rows[-1] + 2 * size) & (all_cols <= cols[-1] + 2 * size)
    return beyond & window, strength
