"""Proposes what a camera's mask may hide, from several of its pictures: lens corners, captions, standing structures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, Float64Array, UInt8Array
from ltm_core.vision.areas import ERASED, NamedArea
from ltm_core.vision.caption_strips import caption_strips
from ltm_core.vision.labels import Label
from ltm_core.vision.lens_corners import lens_corners
from ltm_core.vision.masks import fill
from ltm_core.vision.segmenter import Segmenter
from ltm_core.vision.standing_structures import labelled_skyline, standing_structures

WORKING_WIDTH = 640
MOST_FRAMES = 24
"""Pictures that are looked at: more tell no more."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """`hidden`: (H, W) bool at the pictures' size. `kind`: lens, caption, structure, or the class of a drawn area."""

    kind: str
    hidden: BoolArray
    reason: str


def propose_mask(
    frames: Sequence[UInt8Array], segmenter: Segmenter, skyline: Float64Array | None = None
) -> list[Proposal]:
    """From pictures (H, W, 3) RGB of one fixed camera, the more different their light the better.

    `skyline`: (W,) rows above which there can be no terrain, by the camera's pose; None: as the labels have it.
    Deterministic. Raises ImageError where pictures differ in size, or there are none.
    """
    shape = _common_shape(frames)
    height, width = shape
    small_width = min(WORKING_WIDTH, width)
    size = small_width, max(1, round(height * small_width / width))
    small = [np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), np.uint8) for frame in frames]
    count = "1 frame" if len(frames) == 1 else f"{len(frames)} frames"
    found = [
        Proposal("lens", _at(corner.hidden, shape), f"smooth corner cut off by an arc, in {count}")
        for corner in lens_corners(small)
    ]
    found += [
        Proposal("caption", strip, f"rows of letters in the same place, in {count}") for strip in caption_strips(frames)
    ]
    sky = [segmenter.segment(frame).labels == np.uint8(Label.SKY) for frame in small]
    excluded = np.zeros(size[::-1], np.bool_)
    for proposal in found:
        excluded |= _at(proposal.hidden, size[::-1])
    if skyline is None:
        line, above = labelled_skyline(sky), "above the labels' skyline"
    else:
        line = np.interp(np.arange(size[0]), np.arange(width) * size[0] / width, skyline) * size[1] / height
        above = "above all terrain that the pose lets expect"
    found += [
        Proposal("structure", _at(part, shape), f"stands still {above}, in {count}")
        for part in standing_structures(small, sky, line, excluded)
    ]
    return found


def drawn_proposals(areas: Sequence[NamedArea], names: Sequence[str], shape: tuple[int, int]) -> list[Proposal]:
    """Of areas that a person has drawn, in their order, in pictures of this size (H, W), those that hide the landscape:
    of no class of `names`. What was drawn or erased over them later, in the same picture, is no part of them."""
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
        raise ImageError("no pictures to propose a mask from")
    shapes = {frame.shape for frame in frames}
    if len(shapes) > 1:
        said = ", ".join(sorted(f"{shape[1]} x {shape[0]}" for shape in shapes))
        raise ImageError(f"the pictures have different sizes ({said}); name those of one camera alone")
    return frames[0].shape[0], frames[0].shape[1]


def _at(hidden: BoolArray, shape: tuple[int, ...]) -> BoolArray:
    if hidden.shape == shape:
        return hidden
    resized = cv2.resize(hidden.astype(np.float32), shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(resized > 0.5, np.bool_)
