"""NumPy images <-> sensor_msgs/Image and sensor_msgs/CompressedImage.

Assigning an ndarray to `msg.data` costs a Python loop over every byte (257 ms for 1080p rgb8); filling the message's
buffer through a view costs 0.12 ms. So buffers are filled in place, and reused when the caller hands a message back.
"""

from __future__ import annotations

import io
from array import array as byte_array
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import PIL.Image
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.storage.text_io import BROKEN, MAX_PIXELS, png_is_whole
from ltm_msgs_py.stamp import make_header


@dataclass(frozen=True)
class _Encoding:
    dtype: np.dtype[Any]
    channels: int


ENCODINGS = {
    "rgb8": _Encoding(np.dtype(np.uint8), 3),
    "bgr8": _Encoding(np.dtype(np.uint8), 3),
    "rgba8": _Encoding(np.dtype(np.uint8), 4),
    "bgra8": _Encoding(np.dtype(np.uint8), 4),
    "mono8": _Encoding(np.dtype(np.uint8), 1),
    "mono16": _Encoding(np.dtype(np.uint16), 1),
    "16UC1": _Encoding(np.dtype(np.uint16), 1),
    "32FC1": _Encoding(np.dtype(np.float32), 1),
    "32FC3": _Encoding(np.dtype(np.float32), 3),
}
"""Encodings that `image_to_msg` and `msg_to_array` support; names as in sensor_msgs/image_encodings.hpp."""

COLOUR_ENCODINGS = ("rgb8", "bgr8", "rgba8", "bgra8", "mono8", "mono16")
DEPTH_ENCODINGS = ("32FC1", "16UC1")

_MOST_SCANS = 200
"""Maximum number of scans of a JPEG, including its thumbnails: a progressive one has ten. Each is a pass over all
pixels, so a few kilobytes of empty scans take minutes.
"""


def image_to_msg(image: NDArray[Any], encoding: str, stamp_ns: int, frame_id: str, out: Image | None = None) -> Image:
    """Return an array as an Image.

    `image`: (H, W) or (H, W, channels) of the dtype that `encoding` (a key of `ENCODINGS`) says; any strides. `out`: a
    message to fill instead of a new one; its buffer is reused when it has the right size. Raises ImageError.
    """
    spec = _spec(encoding, tuple(ENCODINGS), "to write")
    expected_ndim = 2 if spec.channels == 1 else 3
    if (
        image.ndim != expected_ndim
        or 0 in image.shape
        or image.dtype != spec.dtype
        or (expected_ndim == 3 and image.shape[2] != spec.channels)
    ):
        wanted = "(H, W)" if spec.channels == 1 else f"(H, W, {spec.channels})"
        raise ImageError(
            f"an image to write as {encoding} must be {wanted} {spec.dtype}, got {image.shape} {image.dtype}"
        )
    msg = Image() if out is None else out
    msg.header = make_header(stamp_ns, frame_id)
    msg.height, msg.width = image.shape[:2]
    msg.encoding = encoding
    msg.is_bigendian = 0
    msg.step = image.shape[1] * spec.channels * spec.dtype.itemsize
    if len(msg.data) != image.nbytes:
        buffer = byte_array("B")
        # frombytes takes any contiguous buffer of bytes and copies once; bytes() would copy twice.
        buffer.frombytes(np.ascontiguousarray(image).data.cast("B"))
        msg.data = buffer
    else:
        np.frombuffer(msg.data, spec.dtype).reshape(image.shape)[...] = image
    return msg


def msg_to_array(msg: Any, encodings: tuple[str, ...] = tuple(ENCODINGS)) -> NDArray[Any]:
    """Return the pixels of an Image in the layout of the message: (H, W) or (H, W, channels), row padding cut off.

    A view of the message's buffer (no copy) unless the data is big-endian. Raises ImageError when the encoding is not
    among `encodings`, or height, width, step and the data's length contradict each other.
    """
    spec = _spec(msg.encoding, encodings, "to read")
    height, width, step = int(msg.height), int(msg.width), int(msg.step)
    row_bytes = width * spec.channels * spec.dtype.itemsize
    size = len(msg.data)
    if height < 1 or width < 1 or step < row_bytes or size != height * step:
        raise ImageError(
            f"{msg.encoding} image of {width} x {height} with step {step} holds {size} bytes; its step must be at "
            f"least {row_bytes} and its data height * step = {height * step} bytes"
        )
    dtype = spec.dtype
    if msg.is_bigendian and dtype.itemsize > 1:
        dtype = dtype.newbyteorder(">")
    rows = np.frombuffer(msg.data, np.uint8).reshape(height, step)[:, :row_bytes]
    if step % dtype.itemsize:
        rows = np.ascontiguousarray(rows)  # a padded row that ends inside a sample leaves the next one unaligned
    pixels: NDArray[Any] = rows.view(dtype)
    if spec.channels > 1:
        pixels = pixels.reshape(height, width, spec.channels)
    return pixels if dtype.isnative else pixels.astype(spec.dtype)


def msg_to_rgb(msg: Any) -> UInt8Array:
    """Return a colour or grey Image as (H, W, 3) uint8 RGB; no copy when it is rgb8. mono16 keeps its high byte.

    Raises ImageError as `msg_to_array` does.
    """
    pixels = msg_to_array(msg, COLOUR_ENCODINGS)
    match msg.encoding:
        case "rgb8":
            return pixels
        case "bgr8":
            return _converted(pixels, cv2.COLOR_BGR2RGB)
        case "rgba8":
            return _converted(pixels, cv2.COLOR_RGBA2RGB)
        case "bgra8":
            return _converted(pixels, cv2.COLOR_BGRA2RGB)
        case "mono16":
            pixels = (pixels >> 8).astype(np.uint8)
    return _converted(pixels, cv2.COLOR_GRAY2RGB)


def depth_to_msg(depth: Float32Array, stamp_ns: int, frame_id: str, out: Image | None = None) -> Image:
    """Return a depth image, (H, W) float32 metres along the optical axis, as 32FC1 (REP-118). Raises ImageError."""
    return image_to_msg(depth, "32FC1", stamp_ns, frame_id, out)


def msg_to_depth(msg: Any) -> Float32Array:
    """Return a depth Image as (H, W) float32 metres: 32FC1 without a copy, 16UC1 from millimetres with 0 as NaN.

    Source: REP-118. Raises ImageError as `msg_to_array`.
    """
    pixels = msg_to_array(msg, DEPTH_ENCODINGS)
    if msg.encoding == "32FC1":
        return pixels
    metres = pixels.astype(np.float32) / np.float32(1000)
    metres[pixels == 0] = np.nan
    return metres


def compressed_to_msg(data: bytes, image_format: str, stamp_ns: int, frame_id: str) -> CompressedImage:
    """JPEG or PNG bytes as they are. Raises ImageError where `data` does not begin like `image_format`."""
    found = _format_of(data)
    if found is None or found != image_format:
        raise ImageError(
            f"{len(data)} bytes given as {image_format!r} begin with {data[:8].hex(' ') or 'nothing'}: "
            f"that is {found or 'neither jpeg nor png'}"
        )
    msg = CompressedImage(header=make_header(stamp_ns, frame_id), format=image_format)
    buffer = byte_array("B")
    buffer.frombytes(data)
    msg.data = buffer
    return msg


def encode_rgb(image: UInt8Array, image_format: str = "jpeg", quality: int = 92) -> bytes:
    """(H, W, 3) uint8 RGB as JPEG (of `quality` 1..100) or PNG bytes. Raises ImageError."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or 0 in image.shape:
        raise ImageError(f"an image to compress must be (H, W, 3) uint8, got {image.shape} {image.dtype}")
    if image_format not in ("jpeg", "png") or not 1 <= quality <= 100:
        raise ImageError(
            f"images are compressed as 'jpeg' with quality 1..100 or 'png', not {image_format!r} with {quality}"
        )
    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if image_format == "jpeg" else []
    done, encoded = cv2.imencode(f".{image_format}", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
    if not done:
        raise ImageError(f"OpenCV could not write {image.shape} as {image_format}")
    return bytes(encoded.tobytes())


def compressed_to_rgb(msg: Any) -> UInt8Array:
    """Return a CompressedImage (jpeg or png, detected by its bytes) as (H, W, 3) uint8 RGB, in stored pixel order.

    An EXIF orientation tag is left aside: the calibration counts the pixels as they are stored. Raises ImageError with
    format and size when the data is neither, is cut short, or cannot be decoded.
    """
    return decode_rgb(bytes(memoryview(msg.data)), _named(msg))


def compressed_size(msg: Any) -> tuple[int, int]:
    """Return the stated (width, height) of a CompressedImage without decoding it. Raises ImageError if there is none,
    or the image is truncated.
    """
    return _checked_size(bytes(memoryview(msg.data)), _named(msg))[0]


def image_format(data: bytes) -> str:
    """Return `jpeg` or `png`, by the first bytes. Raises ImageError."""
    found = _format_of(data)
    if found is None:
        raise ImageError(f"{len(data)} bytes beginning {data[:8].hex(' ') or 'with nothing'} are neither jpeg nor png")
    return found


def picture_size(data: bytes, what: str = "picture") -> tuple[int, int]:
    """Like `compressed_size`, for JPEG or PNG bytes."""
    return _checked_size(data, what)[0]


def decode_rgb(data: bytes, what: str = "image") -> UInt8Array:
    """JPEG or PNG bytes as (H, W, 3) uint8 RGB; `what` names the image in errors. See `compressed_to_rgb`."""
    (width, height), found = _checked_size(data, what)
    if width * height > MAX_PIXELS:
        raise ImageError(
            f"{what} ({len(data)} bytes of {found}) states a size of {width} x {height}: "
            f"more than {MAX_PIXELS // 1_000_000} million pixels are not decoded; send a smaller image"
        )
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise ImageError(f"{what} ({len(data)} bytes of {found}) cannot be decoded: {error.err}") from error
    if image is None:
        raise ImageError(f"{what} ({len(data)} bytes of {found}) is corrupt: OpenCV cannot decode it")
    return _converted(image, cv2.COLOR_BGR2RGB)


def _named(msg: Any) -> str:
    return f"CompressedImage with format {msg.format!r}"


def _checked_size(data: bytes, what: str) -> tuple[tuple[int, int], str]:
    """Return (width, height) and format of an image that looks complete. Raises ImageError."""
    found = _format_of(data)
    if found is None:
        raise ImageError(
            f"{what} ({len(data)} bytes, beginning {data[:8].hex(' ') or 'with nothing'}) is neither jpeg nor png; "
            "publish one of these, or raw images"
        )
    # OpenCV 4 fills the missing part of a cut JPEG with grey and says nothing, so look for its end ourselves.
    if found == "jpeg" and not _jpeg_is_whole(data):
        raise ImageError(f"{what} ({len(data)} bytes of jpeg) is truncated: it has no end-of-image marker")
    if found == "png" and not png_is_whole(data):
        raise ImageError(f"{what} ({len(data)} bytes of png) is truncated: its chunks state more bytes than it has")
    if found == "jpeg" and (scans := data.count(b"\xff\xda")) > _MOST_SCANS:
        raise ImageError(
            f"{what} ({len(data)} bytes of jpeg) has {scans} scans, at most {_MOST_SCANS} are decoded; save it again"
        )
    return _stated_size(data, f"{what} ({len(data)} bytes of {found})"), found


def _spec(encoding: str, taken: tuple[str, ...], purpose: str) -> _Encoding:
    if encoding not in taken or encoding not in ENCODINGS:
        raise ImageError(f"image encoding {encoding!r} is not supported {purpose}; supported: {', '.join(taken)}")
    return ENCODINGS[encoding]


def _converted(pixels: NDArray[Any], code: int) -> UInt8Array:
    return np.asarray(cv2.cvtColor(pixels, code), np.uint8)


def _format_of(data: bytes) -> str | None:
    if data[:3] == b"\xff\xd8\xff":
        return "jpeg"
    return "png" if data[:8] == b"\x89PNG\r\n\x1a\n" else None


def _stated_size(data: bytes, what: str) -> tuple[int, int]:
    """Return (width, height) from the header, without decoding."""
    try:
        with PIL.Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as header:
            return header.size
    except PIL.Image.DecompressionBombError as error:
        raise ImageError(f"{what} is too large to decode: {error}") from error
    except BROKEN as error:
        raise ImageError(f"{what} is corrupt: its header cannot be read") from error


def _jpeg_is_whole(data: bytes) -> bool:
    """Return whether an end-of-image marker follows the first scan. Segments are skipped, because a thumbnail has its
    own.
    """
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
            continue
        if marker == 0xDA:  # start of scan: entropy-coded data follows
            return data.rfind(b"\xff\xd9", at) >= 0
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return False
