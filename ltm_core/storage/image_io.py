"""Decode compressed images. Only this file calls Pillow, libheif and OpenCV for that.

A decoder fills what a truncated image lacks with grey or green and reports nothing, so each image is checked here:
filled-in pixels are labelled built or water, and would vote."""

from __future__ import annotations

import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.storage.jpeg_data import Jpeg

# Pillow warns of large images and odd EXIF; what matters is checked here.
warnings.filterwarnings("ignore", module=r"PIL|pillow_heif")

LARGEST_FILE = 256 << 20
"""Maximum size of a photo file in bytes."""
MAX_PIXELS = 64_000_000
"""Maximum number of pixels of a compressed image; a few kilobytes can claim gigapixels, which would use all memory of a
tower."""

_FORMATS = ("JPEG", "PNG", "TIFF", "GIF", "BMP", "WEBP", "AVIF")
"""Formats that are opened besides HEIF (MPO with JPEG). Other formats of Pillow are not tried: for EPS it starts
Ghostscript."""
_BROKEN = (
    *(OSError, ValueError, SyntaxError, TypeError, LookupError, AttributeError, ArithmeticError, EOFError),
    *(RuntimeError, MemoryError, struct.error, Image.DecompressionBombError),
)
"""Errors that Pillow, its plugins and their EXIF parsers raise for damaged files; they have no common class."""
_PHOTOS = {".jpg", ".jpeg", ".png"}
_ORIENTATION, _DNG_VERSION, _SUBFILE_TYPE, _SUB_IFDS = 0x0112, 0xC612, 0x00FE, 0x014A
_REDUCED = {
    1: cv2.IMREAD_COLOR,
    2: cv2.IMREAD_REDUCED_COLOR_2,
    4: cv2.IMREAD_REDUCED_COLOR_4,
    8: cv2.IMREAD_REDUCED_COLOR_8,
}
_MOST_SCANS = 200
"""Maximum number of scans of a JPEG: a progressive one has ten. Each is a pass over all pixels, so a few kilobytes of
empty scans take minutes."""
_MOST_ZEROS = 1024
"""Maximum number of zero bytes at the end of complete compressed data."""
_FILL = 128
"""Value that libjpeg gives to all channels of a block without data."""


@contextmanager
def opened_picture(data: bytes, place: Path | str) -> Iterator[Image.Image]:
    """Return the image of a file's bytes for its header, not decoded; `place` names it in errors. Raises ImageError for
    other files, too large ones, and any Pillow error in the block; other errors in the block must be ImageErrors
    already."""
    formats: tuple[str, ...] = _FORMATS
    if data[4:8] == b"ftyp":
        from pillow_heif import register_heif_opener  # here, for live nodes take JPEG and PNG alone

        register_heif_opener()
        formats = (*formats, "HEIF")
    try:
        with Image.open(BytesIO(data), formats=formats) as image:
            _check_pixels(*image.size, str(place))
            yield image
    except UnidentifiedImageError as error:
        raise ImageError(f"{place}: cannot be read: it has an unsupported format or is truncated") from error
    except _BROKEN as error:
        raise ImageError(f"{place}: cannot be read as an image ({type(error).__name__}: {error})") from error


def read_picture(path: Path) -> bytes:
    """Return a photo file's bytes. Raises ImageError if it is missing, empty or too large."""
    try:
        with path.open("rb") as file:
            data = file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        raise ImageError(f"{path}: cannot be read ({error})") from error
    if len(data) > LARGEST_FILE:
        raise ImageError(f"{path}: cannot be read: it has more than {LARGEST_FILE >> 20} MiB; use a smaller photo")
    if not data:
        raise ImageError(f"{path}: the file is empty; copy it again")
    return data


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
    data = read_picture(path)
    return upright(decode_rgb(data, str(path)), orientation(data, path))


def read_values(path: Path) -> NDArray[Any]:
    """Return the stored pixel values of a mask or of label ids: (H, W), or (H, W, channels) for one in colours. Raises
    ImageError, also for lossy formats."""
    data = read_picture(path)
    with opened_picture(data, path) as image:
        if image.format not in ("PNG", "TIFF", "BMP"):
            raise ImageError(f"{path} is a {image.format}, which blurs edges; save it as PNG")
        return np.asarray(image)


def orientation(data: bytes, place: Path | str) -> int:
    """Return the EXIF orientation that applies to the decoded pixels: 1 if there is none."""
    with opened_picture(data, place) as image:
        stated = image.getexif().get(_ORIENTATION, 1)
        # libheif turns a HEIC image by its own format, and Pillow a TIFF by its tag.
        return stated if stated in range(1, 9) and image.format not in ("HEIF", "TIFF") else 1


def upright(pixels: UInt8Array, turn: int) -> UInt8Array:
    """Return stored pixels as an EXIF orientation shows them."""
    image = Image.fromarray(pixels)
    image.getexif()[_ORIENTATION] = turn
    return pixels if turn == 1 else np.asarray(ImageOps.exif_transpose(image), np.uint8)


def image_format(data: bytes) -> str:
    """Return `jpeg` or `png`, by the first bytes; empty for others."""
    if data[:3] == b"\xff\xd8\xff":
        return "jpeg"
    return "png" if data[:8] == b"\x89PNG\r\n\x1a\n" else ""


def stated_size(data: bytes, what: str = "image") -> tuple[int, int]:
    """Return the (width, height) that an image's header states. Raises ImageError."""
    match image_format(data):
        case "jpeg":
            header = Jpeg.of(data, what, header_only=True)
            return header.width, header.height
        case "png" if data[12:16] == b"IHDR" and len(data) >= 24:
            width, height = struct.unpack_from(">II", data, 16)
            return width, height
    with opened_picture(data, what) as image:
        return image.size


def decode_rgb(data: bytes, what: str = "image", reduced: int = 1) -> UInt8Array:
    """Return an image's pixels in stored order, (H, W, 3) uint8 RGB; `what` names it in errors.

    `reduced`: 2, 4 or 8 for a JPEG of that fraction of the size, at a fraction of the cost; other formats are sampled.
    An EXIF orientation is left aside: a calibration counts the pixels as they are stored. Raises ImageError for damaged
    data, and with the missing share if data are missing."""
    match image_format(data):
        case "jpeg":
            return _jpeg_rgb(data, f"{what} ({len(data)} bytes of jpeg)", reduced)
        case "png":
            return _png_rgb(data, f"{what} ({len(data)} bytes of png)", reduced)
    pixels = _other_rgb(data, what)
    return np.ascontiguousarray(pixels[reduced // 2 :: reduced, reduced // 2 :: reduced])


def without_tail(data: bytes) -> bytes:
    """Return a JPEG without what follows its image: the video of a motion photo, or the second image of a pair. Other
    formats stay as they are."""
    return Jpeg.of(data, "image").alone(data) if image_format(data) == "jpeg" else data


def _check_pixels(width: int, height: int, what: str) -> None:
    if width * height > MAX_PIXELS:
        raise ImageError(
            f"{what}: states a size of {width} x {height}: more than {MAX_PIXELS // 1_000_000} million pixels are not "
            "decoded; use a smaller image"
        )


def _by_opencv(data: bytes, what: str, reduced: int) -> UInt8Array:
    flags = _REDUCED[reduced] | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise ImageError(f"{what} cannot be decoded: {error.err}") from error
    if image is None:
        raise ImageError(f"{what} is corrupt: OpenCV cannot decode it")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


def _png_rgb(data: bytes, what: str, reduced: int) -> UInt8Array:
    if not _png_is_whole(data):
        raise ImageError(f"{what} is truncated: its chunks state more bytes than it has")
    _check_pixels(*stated_size(data, what), what)
    return _by_opencv(data, what, reduced)


def _png_is_whole(data: bytes) -> bool:
    """Return whether all chunks up to the end chunk are within the data. OpenCV allocates what a chunk states, up to a
    gigabyte, before it notices that the file ends earlier. Source: PNG specification, section 5.3."""
    at = 8
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at += 12 + length
    return False


def _other_rgb(data: bytes, what: str) -> UInt8Array:
    missing = _missing_bytes(data)
    if missing > 0:
        raise ImageError(f"{what} ({len(data)} bytes) is truncated: {missing:.1%} of it are missing; copy it again")
    with opened_picture(data, what) as image:
        tags = getattr(image, "tag_v2", {})
        if _DNG_VERSION in tags or _SUB_IFDS in tags or tags.get(_SUBFILE_TYPE, 0) & 1:
            raise ImageError(f"{what} is a raw photo (DNG); export it as JPEG")
        if image.format in ("GIF", "WEBP", "AVIF") and getattr(image, "n_frames", 1) > 1:
            raise ImageError(f"{what} is an animation; export one image of it")
        if image.mode.startswith("I;16"):
            return np.repeat((np.asarray(image) >> 8).astype(np.uint8)[..., None], 3, axis=2)
        if image.mode in ("I", "F"):
            raise ImageError(f"{what} has 32-bit values; save it as an 8-bit image")
        return np.asarray(image.convert("RGB"), np.uint8)


def _missing_bytes(data: bytes) -> float:
    """Return the missing share of the bytes that HEIC, AVIF (ISO 14496-12) or WebP (RIFF) state; 0 for other formats.

    Compressed data have no long run of zeros, so zeros at the end come from an incomplete copy."""
    end = 0
    if data[:4] == b"RIFF":
        end = 8 + int.from_bytes(data[4:8], "little")
    elif data[4:8] == b"ftyp":
        kind = b""
        while kind != b"mdat" and end + 8 <= len(data):  # what follows the image may be a video
            size, kind = int.from_bytes(data[end : end + 4], "big"), data[end + 4 : end + 8]
            size = int.from_bytes(data[end + 8 : end + 16], "big") if size == 1 else size or len(data) - end
            end += max(size, 8)
    held = len(data[:end].rstrip(b"\0"))
    held = held if end - held > _MOST_ZEROS else min(end, len(data))
    return 1 - held / end if end else 0.0


def _jpeg_rgb(data: bytes, what: str, reduced: int) -> UInt8Array:
    """Decode a JPEG, and check that the decoder filled in nothing.

    If the image has one scan, blocks without data are grey. The rare image that has such blocks is decoded again, small
    and with other data where data may be missing: only filled-in blocks change. Images of several scans are always
    decoded twice."""
    jpeg = Jpeg.of(data, what)
    if len(jpeg.scans) > _MOST_SCANS:
        raise ImageError(f"{what} has {len(jpeg.scans)} scans, at most {_MOST_SCANS} are decoded; save the image again")
    _check_pixels(jpeg.width, jpeg.height, what)
    missing = jpeg.unfinished
    if jpeg.simple:
        image = _by_opencv(jpeg.alone(data), what, reduced)
        side = max(8 // reduced, 2)
        grey = _grey_blocks(image, side)
        if grey.any() and jpeg.restarts_as_expected(data):
            step = side * reduced // 8
            small = _by_pillow(jpeg.with_other_data(data), what, 8)[::step, ::step]
            grey &= (small[: grey.shape[0], : grey.shape[1]][grey] != _FILL).any()
        missing = float(grey.mean()) if grey.any() else 0.0
    elif not missing:
        image = _by_pillow(jpeg.alone(data), what, reduced)
        other = _by_pillow(jpeg.with_other_data(data), what, reduced)
        missing = 0.0 if np.array_equal(image, other) else float((image != other).any(axis=2).mean())
    if missing:
        raise ImageError(f"{what} is truncated: {missing:.1%} of the image are missing; send or copy it again")
    return image


def _by_pillow(data: bytes, what: str, reduced: int) -> UInt8Array:
    """Decode a JPEG. Unlike OpenCV, Pillow prints no warning."""
    with opened_picture(data, what) as image:
        image.draft("RGB", (max(1, image.width // reduced), max(1, image.height // reduced)))
        return np.asarray(image.convert("RGB"), np.uint8)


def _grey_blocks(image: UInt8Array, side: int) -> BoolArray:
    """Return which whole blocks of `side` x `side` pixels have the grey of missing data only, except near their edges,
    which chroma interpolation blends."""
    corner, rows, columns = image[side // 2 :: side, side // 2 :: side], *(n // side for n in image.shape[:2])
    found = np.asarray((corner[..., 0] == _FILL) & (corner[..., 1] == _FILL), np.bool_)[:rows, :columns]
    inner = slice(side // 4, side - side // 4)
    blocks = image[: rows * side, : columns * side].reshape(rows, side, columns, side, 3)[:, inner, :, inner]
    at = np.nonzero(found)
    found[at] = (blocks[at[0], :, at[1]] == _FILL).all(axis=(1, 2, 3))
    return found
