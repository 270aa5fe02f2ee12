"""Pictures that show when they were made, so that a stamp can be held against the truth: milliseconds as black and
white squares in the upper left corner of a coloured scene."""

import io

import cv2
import numpy as np
import PIL.Image

from ltm_core.base.types import UInt8Array

BITS, SQUARE, ACROSS = 44, 16, 11
"""Milliseconds since the epoch have 41 bits until 2039."""


def scene(width: int = 320, height: int = 180, seed: int = 3) -> UInt8Array:
    """(H, W, 3) RGB, coloured and never the same noise twice."""
    fixed = np.random.default_rng(seed).integers(30, 225, (5, 8, 3)).astype(np.uint8)
    smooth = cv2.resize(fixed, (width, height), interpolation=cv2.INTER_CUBIC).astype(np.int16)
    noise = np.random.default_rng().integers(-6, 7, (height, width, 1), np.int16)
    return np.clip(smooth + noise, 0, 255).astype(np.uint8)


def with_time(image: UInt8Array, moment: float) -> UInt8Array:
    """`moment`: seconds since the epoch."""
    marked = image.copy()
    count = round(moment * 1000)
    for bit in range(BITS):
        row, column = divmod(bit, ACROSS)
        value = 255 if count >> bit & 1 else 0
        marked[row * SQUARE : (row + 1) * SQUARE, column * SQUARE : (column + 1) * SQUARE] = value
    return marked


def time_in(image: UInt8Array) -> float:
    """What `with_time` wrote, after compression."""
    count = 0
    for bit in range(BITS):
        row, column = divmod(bit, ACROSS)
        middle = image[row * SQUARE + 4 : (row + 1) * SQUARE - 4, column * SQUARE + 4 : (column + 1) * SQUARE - 4]
        count |= int(middle.mean() > 127) << bit
    return count / 1000


def jpeg(image: UInt8Array, mode: str = "RGB", exif: bytes = b"") -> bytes:
    """`mode`: RGB, L or CMYK, as Pillow names them."""
    out = io.BytesIO()
    PIL.Image.fromarray(image).convert(mode).save(out, "JPEG", quality=90, exif=exif)
    return out.getvalue()


def exif_of(moment_text: str, fraction: str = "", zone: str = "") -> bytes:
    """EXIF with the time of exposure: `2026:08:01 12:00:00`, `250`, `-07:00`."""
    exif = PIL.Image.Exif()
    photo = exif.get_ifd(0x8769)
    photo[0x9003] = moment_text
    if fraction:
        photo[0x9291] = fraction
    if zone:
        photo[0x9011] = zone
    exif[0x8769] = photo
    return exif.tobytes()
