"""Read text, NumPy's files and photos within bounds.

Read text files and NumPy's files within bounds.

Reads NumPy's own files (.npy, .npz) within bounds, without pickles.

A header may state any shape, and `numpy.load` reserves what it states; an entry of an .npz may unfold a thousandfold.
"""

from __future__ import annotations

import struct
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from ltm_core.base.errors import ImageError, LtmError
from ltm_core.base.types import UInt8Array

LARGEST_TABLE = 4 << 20
"""Maximum size in bytes of a CSV file or of an index in JSON."""


def read_text(path: Path, most: int, error: type[LtmError], encoding: str = "utf-8") -> str:
    """Return the whole of a text file. Raises `error` for a missing file, more than `most` bytes, or invalid
    `encoding`."""
    try:
        with path.open("rb") as file:
            content = file.read(most + 1)
    except (OSError, ValueError) as reason:  # ValueError: a name that no file can have
        raise error(f"{path}: cannot be read ({getattr(reason, 'strerror', None) or reason})") from reason
    if len(content) > most:
        raise error(f"{path}: cannot be read (it has more than {most} bytes); split it")
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as reason:
        raise error(f"{path}: cannot be read (not text in UTF-8: {reason}); save it as UTF-8") from reason


_BROKEN = (
    *(OSError, ValueError, TypeError, LookupError, EOFError, SyntaxError, MemoryError, OverflowError),
    *(RuntimeError, zlib.error, zipfile.BadZipFile, tokenize.TokenError),
)
"""Errors that NumPy, the header's parser and zipfile raise for damaged bytes."""


def load_array(content: bytes, what: str, error: type[LtmError]) -> NDArray[Any]:
    """Return an array from the bytes of an .npy file; `what` names it in errors. Raises `error` for other bytes, a
    wrong size, and Python objects."""
    try:
        return _array(BytesIO(content), len(content))
    except _BROKEN as reason:
        raise error(f"{what} is damaged: not a NumPy array ({type(reason).__name__}: {reason})") from reason


def load_arrays(path: Path, names: Sequence[str], most_bytes: int, error: type[LtmError]) -> list[NDArray[Any]]:
    """Return these arrays of an .npz file. Raises `error` for a missing file or array, or more than `most_bytes`."""
    try:
        with zipfile.ZipFile(path) as archive:
            arrays = []
            for name in names:
                entry = archive.getinfo(f"{name}.npy")
                if entry.file_size > most_bytes:
                    raise ValueError(f"{name} has {entry.file_size} bytes, at most {most_bytes} are read")
                with archive.open(entry) as stream:
                    arrays.append(_array(stream, entry.file_size))  # type: ignore[arg-type]
            return arrays
    except _BROKEN as reason:
        raise error(f"{path}: expected an .npz with {', '.join(names)} ({type(reason).__name__}: {reason})") from reason


def _array(stream: BinaryIO, size: int) -> NDArray[Any]:
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(stream)
    if dtype.hasobject or min(shape, default=1) < 0 or prod(shape) * dtype.itemsize > size:
        raise ValueError(f"states {shape} of {dtype} in {size} bytes")
    values = np.frombuffer(stream.read(prod(shape) * dtype.itemsize), dtype)
    return values.reshape(shape[::-1]).T if fortran else values.reshape(shape)


LARGEST_FILE = 256 << 20
"""Maximum size of a photo file in bytes."""
MAX_PIXELS = 64_000_000
"""Maximum number of pixels of a compressed image; a few kilobytes can claim gigapixels, which would use all memory of a
tower."""

FORMATS = ("JPEG", "PNG", "HEIF", "TIFF", "GIF", "BMP", "WEBP")
"""Formats that are opened (MPO with JPEG). Other formats of Pillow are not tried: for EPS it starts Ghostscript."""

BROKEN = (
    *(OSError, ValueError, SyntaxError, TypeError, LookupError, AttributeError, ArithmeticError, EOFError),
    *(RuntimeError, MemoryError, struct.error, Image.DecompressionBombError),
)
"""Errors that Pillow, its plugins and their EXIF parsers raise for damaged files; they have no common class."""
_PHOTOS = {".jpg", ".jpeg", ".png"}


@contextmanager
def open_picture(path: Path) -> Iterator[tuple[Image.Image, bytes]]:
    """Open an image without decoding it; gives the image and the file's bytes. Raises ImageError for other files, too
    large ones, and any Pillow error in the block; other errors in the block must be ImageErrors already."""
    data = read_picture(path)
    with opened_picture(data, path) as image:
        yield image, data


def photos_in(images: Path) -> list[Path]:
    """Return the photos of a folder by name, without label images, or a single file. Raises ImageError if there is
    none."""
    paths = [images] if images.is_file() else sorted(images.glob("*"))
    photos = [path for path in paths if path.suffix.lower() in _PHOTOS and not path.stem.endswith("_labels")]
    if not photos:
        raise ImageError(f"{images}: no photos; expected files ending in {', '.join(sorted(_PHOTOS))}")
    return photos


def read_rgb(path: Path) -> UInt8Array:
    """Return a photo upright as its EXIF says, (H, W, 3) RGB. Raises ImageError."""
    with open_picture(path) as (source, _):
        return np.asarray(ImageOps.exif_transpose(source).convert("RGB"), np.uint8)


def read_picture(path: Path) -> bytes:
    """Return a photo file's bytes. Raises ImageError if it is missing or too large."""
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        raise ImageError(f"{path}: cannot be read ({error})") from error
    if len(data) > LARGEST_FILE:
        raise ImageError(f"{path}: cannot be read: it has more than {LARGEST_FILE >> 20} MiB; use a smaller photo")
    return data


@contextmanager
def opened_picture(data: bytes, path: Path) -> Iterator[Image.Image]:
    """Return the image of a file's bytes, not decoded. `path`: its name in errors. Raises as `open_picture`."""
    from pillow_heif import register_heif_opener  # here, for live nodes take JPEG and PNG alone

    register_heif_opener()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns of large images and odd EXIF; what matters is checked here
            with Image.open(BytesIO(data), formats=FORMATS) as image:
                if image.width * image.height > MAX_PIXELS:
                    raise ImageError(
                        f"{path}: states a size of {image.width} x {image.height}: more than "
                        f"{MAX_PIXELS // 1_000_000} million pixels are not decoded; use a smaller photo"
                    )
                yield image
    except UnidentifiedImageError as error:
        raise ImageError(f"{path}: cannot be read: it has an unsupported format or is truncated") from error
    except BROKEN as error:
        raise ImageError(f"{path}: cannot be read as an image ({type(error).__name__}: {error})") from error


def check_picture(path: Path) -> None:
    """Check a file before OpenCV decodes it. Raises ImageError for other files, and images that are too large."""
    with open_picture(path) as (image, data):
        if image.format == "PNG" and not png_is_whole(data):
            raise ImageError(f"{path} ({len(data)} bytes) is truncated: its chunks state more bytes than it has")


def png_is_whole(data: bytes) -> bool:
    """Return whether all chunks up to the end chunk are within the data. OpenCV allocates what a chunk states, up to a
    gigabyte, before it notices that the file ends earlier. Source: PNG specification, section 5.3."""
    at = 8
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at += 12 + length
    return False
