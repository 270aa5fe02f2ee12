"""Decode compressed images. Only this file calls Pillow, libheif, libjpeg and OpenCV for that.

Decoders fill what a truncated image lacks with grey or green, which would be labelled built or water and vote. So each
image is checked here; of JPEGs, libjpeg's own warnings say it."""

import re
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from ltm_core.base.errors import ImageError
from ltm_core.base.types import UInt8Array

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
_PHOTOS = (".jpg", ".jpeg", ".png", ".heic", ".bmp", ".webp")
"""Suffixes of photos in a folder; .tif is excluded, because rasters use it."""
_ORIENTATION, _DNG_VERSION, _SUBFILE_TYPE, _SUB_IFDS = 0x0112, 0xC612, 0x00FE, 0x014A
_REDUCED = {1: cv2.IMREAD_COLOR} | {n: getattr(cv2, f"IMREAD_REDUCED_COLOR_{n}") for n in (2, 4, 8)}
_MOST_SCANS = 200
"""Maximum number of scans of a JPEG: a progressive one has ten. Each is a pass over all pixels, so a few kilobytes of
empty scans take minutes."""
_MOST_ZEROS = 1024
"""Maximum number of zero bytes at the end of complete compressed data."""
_MOST_SEGMENTS = 10_000
"""Maximum number of segments of a JPEG."""
_HARMLESS = re.compile(r"\b\d{1,3} extraneous bytes|unknown JFIF|Invalid SOS")
"""Warnings of libjpeg about images that are complete."""
_END = b"\xff\xd9"
_MARKER = re.compile(rb"\xff([^\x00\xff\xd0-\xd7])", re.DOTALL)
"""Marker of a JPEG apart from those within a scan."""
_SEQUENTIAL, _IMAGE_END, _SCAN, _JFIF = (0xC0, 0xC1), 0xD9, 0xDA, 0xE0
_ARITHMETIC = range(0xC9, 0xD0)
"""Frame headers of images with arithmetic codes, in which missing data cannot be detected; 0xCC is a table of such."""


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


def photos_in(images: Path, pattern: str = "*") -> list[Path]:
    """Return the photos of a folder by name, without label images and masks, or a single file. Raises ImageError if
    there is none."""
    paths = [images] if images.is_file() else sorted(images.glob(pattern))
    photos = [path for path in paths if path.suffix.lower() in _PHOTOS and path.is_file()]
    found = [path for path in photos if not path.stem.endswith(("_labels", "_mask"))]
    if not found:
        raise ImageError(f"{images}: no photos match {pattern!r}; supported: {', '.join(_PHOTOS)}")
    return found


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
            return _jpeg_header(data, what)[:2]
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
    ends = (end for marker, end in _markers(data) if marker == _IMAGE_END)
    return data[: next(ends, len(data))] if image_format(data) == "jpeg" else data


def _markers(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield each marker of a JPEG and where it ends (ITU-T T.81, annex B), up to the image's end."""
    at, marker = 2, 0
    while marker != _IMAGE_END and (mark := _MARKER.search(data, at)):
        marker = mark[1][0]
        yield marker, mark.end()
        at = mark.end() + int.from_bytes(data[mark.end() : mark.end() + 2], "big")


def _tidied(data: bytes, markers: list[tuple[int, int]]) -> bytes:
    """Return a JPEG without what libjpeg warns of before it decodes: it reports the first warning only, and missing
    data come later."""
    sequential = any(marker in _SEQUENTIAL for marker, _ in markers)
    pieces = [data[:2]]
    for (marker, at), (_, following) in pairwise([*markers, (0, len(data) + 2)]):
        last = at + int.from_bytes(data[at : at + 2], "big")
        segment = bytearray(data[at - 2 : last])
        if marker == _SCAN:
            if sequential:
                segment[-3:] = 0, 63, 0  # all coefficients, as such a scan has anyway
            segment += data[last : following - 2]
        elif marker == _JFIF and segment[4:9] == b"JFIF\0":
            segment[9:10] = b"\1"  # major version
        pieces.append(bytes(segment))
    return b"".join(pieces)


def _check_pixels(width: int, height: int, what: str) -> None:
    if width * height > MAX_PIXELS:
        raise ImageError(
            f"{what}: states a size of {width} x {height}: more than {MAX_PIXELS // 1_000_000} million pixels are not "
            "decoded; use a smaller image"
        )


def _png_rgb(data: bytes, what: str, reduced: int) -> UInt8Array:
    if not _png_is_whole(data):
        raise ImageError(f"{what} is truncated: its chunks state more bytes than it has")
    _check_pixels(*stated_size(data, what), what)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), _REDUCED[reduced] | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise ImageError(f"{what} cannot be decoded: {error.err}") from error
    if image is None:
        raise ImageError(f"{what} is corrupt: OpenCV cannot decode it")
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.uint8)


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


def _jpeg_header(data: bytes, what: str) -> tuple[int, int, str]:
    """Return width, height and the colour space of a JPEG."""
    try:
        height, width, space, _ = simplejpeg.decode_jpeg_header(data, strict=False)
    except (ValueError, KeyError) as error:  # KeyError: an unknown colour space
        raise ImageError(f"{what} is corrupt: its header cannot be read ({error}); copy it again") from error
    return width, height, space


def _jpeg_rgb(data: bytes, what: str, reduced: int) -> UInt8Array:
    width, height, space = _jpeg_header(data, what)
    _check_pixels(width, height, what)
    markers = list(islice(_markers(data), _MOST_SEGMENTS))
    kinds = [marker for marker, _ in markers]
    if (scans := kinds.count(_SCAN)) > _MOST_SCANS or len(kinds) == _MOST_SEGMENTS:
        raise ImageError(
            f"{what} has {scans} scans in {len(kinds)} segments, at most {_MOST_SCANS} in {_MOST_SEGMENTS} are "
            "decoded; save the image again"
        )
    if any(kind in _ARITHMETIC for kind in kinds):
        raise ImageError(f"{what} is a JPEG with arithmetic codes or corrupt; save it again")
    # What follows the image may be a video. An incomplete copy ends with zeros, which decode to blocks.
    data = data[: markers[-1][1]] if kinds[-1:] == [_IMAGE_END] else data.rstrip(b"\0")
    inks = space in ("CMYK", "YCCK")
    size = {"min_height": -(-height // reduced), "min_width": -(-width // reduced), "min_factor": reduced}

    ended, tidy, strict = kinds[-1:] == [_IMAGE_END], False, True
    while True:
        try:
            pixels = simplejpeg.decode_jpeg(data, "CMYK" if inks else "RGB", strict=strict, **size)
        except ValueError as error:
            reason = str(error)
            if not ended and reason.startswith("Premature end"):
                data, ended = data + _END, True  # some cameras leave it out
            elif not tidy and _HARMLESS.search(reason):
                data, tidy = _tidied(data, markers), True
            elif strict and _HARMLESS.search(reason):
                strict = False
            else:
                raise ImageError(f"{what} is truncated or corrupt ({reason}); send or copy it again") from error
        else:
            break
    if not inks:
        return np.asarray(pixels, np.uint8)
    with opened_picture(data, what) as image:
        image.draft("RGB", (max(1, image.width // reduced), max(1, image.height // reduced)))
        return np.asarray(image.convert("RGB"), np.uint8)
