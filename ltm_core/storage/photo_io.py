"""Opens photo files: their formats alone, no larger than can be decoded, with Pillow's errors as ours."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from ltm_core.base.errors import ImageError
from ltm_core.base.types import UInt8Array

LARGEST_FILE = 256 << 20
"""Bytes of a photo file."""
MAX_PIXELS = 64_000_000
"""Of a compressed image: a few kilobytes can claim gigapixels, and decoding them takes the memory of a tower."""

FORMATS = ("JPEG", "PNG", "HEIF", "TIFF", "GIF", "BMP", "WEBP")
"""What is opened (MPO with JPEG). Other formats of Pillow's are not even tried: for EPS it starts Ghostscript."""

BROKEN = (
    *(OSError, ValueError, SyntaxError, TypeError, LookupError, AttributeError, ArithmeticError, EOFError),
    *(RuntimeError, MemoryError, struct.error, Image.DecompressionBombError),
)
"""What Pillow, its plugins and their EXIF raise for files that are damaged: they agree on no error of their own."""
_PHOTOS = {".jpg", ".jpeg", ".png"}


@contextmanager
def open_picture(path: Path) -> Iterator[tuple[Image.Image, bytes]]:
    """The opened image, nothing of it decoded, and the file's bytes. Raises ImageError: no picture, too large, and for
    whatever Pillow raises in the block; what else the block does shall raise ImageError itself."""
    data = read_picture(path)
    with opened_picture(data, path) as image:
        yield image, data


def photos_in(images: Path) -> list[Path]:
    """The photos of a folder in the order of their names, label images left out; of a file, that file. Raises
    ImageError where there is none."""
    paths = [images] if images.is_file() else sorted(images.glob("*"))
    photos = [path for path in paths if path.suffix.lower() in _PHOTOS and not path.stem.endswith("_labels")]
    if not photos:
        raise ImageError(f"{images}: no photos; expected files ending in {', '.join(sorted(_PHOTOS))}")
    return photos


def read_rgb(path: Path) -> UInt8Array:
    """A photo upright as its EXIF says, (H, W, 3) RGB. Raises ImageError."""
    with open_picture(path) as (source, _):
        return np.asarray(ImageOps.exif_transpose(source).convert("RGB"), np.uint8)


def read_picture(path: Path) -> bytes:
    """A photo file's bytes. Raises ImageError: no file, or too large."""
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        raise ImageError(f"{path}: cannot be read ({error})") from error
    if len(data) > LARGEST_FILE:
        raise ImageError(f"{path}: cannot be read: it has more than {LARGEST_FILE >> 20} MiB; send a smaller photo")
    return data


@contextmanager
def opened_picture(data: bytes, path: Path) -> Iterator[Image.Image]:
    """The image of a file's bytes, nothing of it decoded. `path`: what errors call it. Raises as `open_picture`."""
    from pillow_heif import register_heif_opener  # here, for live nodes take JPEG and PNG alone

    register_heif_opener()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of large images and odd EXIF; what matters is checked here
            with Image.open(BytesIO(data), formats=FORMATS) as image:
                if image.width * image.height > MAX_PIXELS:
                    raise ImageError(
                        f"{path}: states a size of {image.width} x {image.height}: more than "
                        f"{MAX_PIXELS // 1_000_000} million pixels are not decoded; send a smaller photo"
                    )
                yield image
    except UnidentifiedImageError as error:
        raise ImageError(
            f"{path}: cannot be read: it is no photo that can be read, of another format or cut short"
        ) from error
    except BROKEN as error:
        raise ImageError(f"{path}: cannot be read as a picture ({type(error).__name__}: {error})") from error


def check_picture(path: Path) -> None:
    """Before OpenCV decodes a file. Raises ImageError: no picture, or one that takes more memory than a picture."""
    with open_picture(path) as (image, data):
        if image.format == "PNG" and not png_is_whole(data):
            raise ImageError(f"{path} ({len(data)} bytes) is cut short: its chunks state more bytes than it has")


def png_is_whole(data: bytes) -> bool:
    """Whether all chunks up to the end chunk lie within the data. OpenCV takes memory for what a chunk states, up to a
    gigabyte, before it sees that the file ends earlier. Source: PNG specification, section 5.3."""
    at = 8
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at += 12 + length
    return False
