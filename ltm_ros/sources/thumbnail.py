"""A picture at an eighth of its size: enough to see whether it is night, and whether it is the same again."""

from __future__ import annotations

import cv2
import numpy as np

from ltm_core.types import UInt8Array
from ltm_ros.sources.errors import PictureError

DARK = 24
"""Grey level below which nothing is seen; cameras' black is 16."""
BRIGHT_SHARE = 0.02
"""Of the pixels, that are brighter at night too: lamps, the moon, a caption."""
GREY = 3
"""Difference of colour channels that compression makes of none."""
HASH_SIZE = 8


def thumbnail_of_bytes(data: bytes) -> UInt8Array:
    """(H / 8, W / 8, 3) BGR of a JPEG or PNG; of a JPEG a tenth of the work that decoding takes. Raises PictureError
    where it cannot be decoded."""
    try:
        small = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_REDUCED_COLOR_8 | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise PictureError(f"picture of {len(data)} bytes cannot be decoded: {error.err}") from None
    if small is None:
        raise PictureError(f"picture of {len(data)} bytes is corrupt: it cannot be decoded")
    return np.asarray(small, np.uint8)


def thumbnail_of_rgb(rgb: UInt8Array) -> UInt8Array:
    """As `thumbnail_of_bytes`, of every eighth pixel."""
    return np.ascontiguousarray(rgb[4::8, 4::8, ::-1]) if min(rgb.shape[:2]) >= 8 else rgb[..., ::-1]


def is_night(thumbnail: UInt8Array) -> bool:
    """Whether all but some lamps is dark, or nothing has a colour, as under infrared light."""
    brightest = thumbnail.max(axis=2)
    if (brightest > DARK).mean() <= BRIGHT_SHARE:
        return True
    colour = brightest - thumbnail.min(axis=2)
    return bool((colour > GREY).mean() <= BRIGHT_SHARE)


def difference_hash(thumbnail: UInt8Array) -> int:
    """64 bits: whether each of 8 x 8 places is brighter than its left neighbour. Pictures that look the same differ in
    few bits (Krawetz's dHash)."""
    grey = cv2.resize(_grey(thumbnail), (HASH_SIZE + 1, HASH_SIZE), interpolation=cv2.INTER_AREA)
    bits = np.packbits(grey[:, 1:] > grey[:, :-1])
    return int.from_bytes(bits.tobytes(), "big")


def same_share(first: UInt8Array, second: UInt8Array) -> float:
    """Of two thumbnails, the share of pixels that are equal to the last digit: between two exposures, noise and light
    change most; 0 where the sizes differ."""
    if first.shape != second.shape:
        return 0.0
    return float((first == second).all(axis=2).mean())


def contrast(thumbnail: UInt8Array) -> float:
    """Standard deviation of grey levels: fog and darkness have next to none."""
    return float(_grey(thumbnail).std())


def _grey(thumbnail: UInt8Array) -> UInt8Array:
    return np.asarray(cv2.cvtColor(thumbnail, cv2.COLOR_BGR2GRAY), np.uint8)
