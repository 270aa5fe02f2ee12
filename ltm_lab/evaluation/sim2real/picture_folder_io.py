"""Reads the pictures of a folder as squares of one size."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import UInt8Array

SUFFIXES = (".jpg", ".jpeg", ".png")
NOT_PICTURES = ("_labels", "_mask", "_depth")
"""Ends of names (before the suffix) that simulator and graph give to rasters that are no pictures."""


def pictures_below(folder: Path) -> list[Path]:
    """The JPEG and PNG pictures of a folder and its subfolders, by name. Raises ImageError where there is none."""
    found = sorted(
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in SUFFIXES and not path.stem.endswith(NOT_PICTURES) and path.is_file()
    )
    if not found:
        raise ImageError(f"{folder} holds no picture: JPEG and PNG files are read")
    return found


def read_square(path: Path, side: int) -> UInt8Array:
    """The middle square of a picture at `side` x `side` pixels, RGB. Raises ImageError on what is no picture."""
    stored = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if stored is None:
        raise ImageError(f"{path}: not a picture that can be decoded")
    return middle_square(np.asarray(stored[..., ::-1], np.uint8), side)


def middle_square(picture: UInt8Array, side: int) -> UInt8Array:
    """The middle square of a picture (H, W, 3) at `side` x `side` pixels, by area means where it shrinks."""
    height, width = picture.shape[:2]
    edge = min(height, width)
    top, left = (height - edge) // 2, (width - edge) // 2
    square = np.ascontiguousarray(picture[top : top + edge, left : left + edge])
    method = cv2.INTER_AREA if side < edge else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(square, (side, side), interpolation=method), np.uint8)
