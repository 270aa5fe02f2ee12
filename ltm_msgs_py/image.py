"""NumPy images <-> sensor_msgs/Image and sensor_msgs/CompressedImage.

Assigning an ndarray to `msg.data` costs a Python loop over every byte (257 ms for 1080p rgb8); filling the message's
buffer through a view costs 0.12 ms. So buffers are filled in place, and reused when the caller hands a message back."""

from array import array as byte_array
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.storage.image_io import decode_rgb, image_format, stated_size
from ltm_msgs_py.stamp import make_header

_SAME = -1
_U8, _U16, _F32 = np.dtype(np.uint8), np.dtype(np.uint16), np.dtype(np.float32)


@dataclass(frozen=True)
class _Encoding:
    """`to_rgb`: OpenCV's conversion of photos, `_SAME`: none is needed, None: it is not a photo's."""

    dtype: np.dtype[Any]
    channels: int
    to_rgb: int | None = None


ENCODINGS = {
    "rgb8": _Encoding(_U8, 3, _SAME),
    **dict.fromkeys(("bgr8", "8UC3"), _Encoding(_U8, 3, cv2.COLOR_BGR2RGB)),  # 8UC3 is OpenCV's own order
    "rgba8": _Encoding(_U8, 4, cv2.COLOR_RGBA2RGB),
    "bgra8": _Encoding(_U8, 4, cv2.COLOR_BGRA2RGB),
    **dict.fromkeys(("mono8", "8UC1"), _Encoding(_U8, 1, cv2.COLOR_GRAY2RGB)),
    **dict.fromkeys(("mono16", "16UC1"), _Encoding(_U16, 1, cv2.COLOR_GRAY2RGB)),
    "32FC1": _Encoding(_F32, 1),
    "32FC3": _Encoding(_F32, 3),
    **dict.fromkeys(("yuv422", "uyvy"), _Encoding(_U8, 2, cv2.COLOR_YUV2RGB_UYVY)),
    **dict.fromkeys(("yuv422_yuy2", "yuyv"), _Encoding(_U8, 2, cv2.COLOR_YUV2RGB_YUYV)),
    **{
        f"bayer_{pattern}{8 * dtype.itemsize}": _Encoding(dtype, 1, getattr(cv2, f"COLOR_Bayer{pattern.upper()}2RGB"))
        for dtype in (_U8, _U16)
        for pattern in ("rggb", "bggr", "gbrg", "grbg")
    },
}
"""Encodings that `image_to_msg` and `msg_to_array` support; names as in sensor_msgs/image_encodings.hpp."""
COLOUR_ENCODINGS = tuple(name for name, encoding in ENCODINGS.items() if encoding.to_rgb is not None)
DEPTH_ENCODINGS = ("32FC1", "16UC1")


def image_to_msg(image: NDArray[Any], encoding: str, stamp_ns: int, frame_id: str) -> Image:
    """Return an array as an Image.

    `image`: (H, W) or (H, W, channels) of the dtype of `encoding` in `ENCODINGS`; any strides. Raises ImageError."""
    spec = _spec(encoding, tuple(ENCODINGS), "to write")
    beyond = () if spec.channels == 1 else (spec.channels,)
    if image.ndim < 2 or image.shape[2:] != beyond or 0 in image.shape or image.dtype != spec.dtype:
        wanted = "(H, W)" if spec.channels == 1 else f"(H, W, {spec.channels})"
        raise ImageError(
            f"an image to write as {encoding} must be {wanted} {spec.dtype}, got {image.shape} {image.dtype}"
        )
    msg = Image(header=make_header(stamp_ns, frame_id), check_fields=True)  # else `data` is copied once more
    msg.height, msg.width = image.shape[:2]
    msg.encoding = encoding
    msg.is_bigendian = 0
    msg.step = image.shape[1] * spec.channels * spec.dtype.itemsize
    buffer = byte_array("B")
    # frombytes takes any contiguous buffer of bytes and copies once; bytes() would copy twice.
    buffer.frombytes(np.ascontiguousarray(image).data.cast("B"))
    msg.data = buffer
    return msg


def msg_to_array(msg: Any, encodings: tuple[str, ...] = tuple(ENCODINGS)) -> NDArray[Any]:
    """Return the pixels of an Image in the layout of the message: (H, W) or (H, W, channels), row padding cut off.

    A view of the message's buffer (no copy) unless the data is big-endian. Raises ImageError when the encoding is not
    among `encodings`, or height, width, step and the data's length contradict each other."""
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
    """Return a colour or grey Image as (H, W, 3) uint8 RGB; rgb8 is a read-only view, 16 bits keep the high byte.

    Raises ImageError as `msg_to_array` does, and for an odd width or size that the encoding does not have."""
    pixels, code = msg_to_array(msg, COLOUR_ENCODINGS), ENCODINGS[msg.encoding].to_rgb
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    if code == _SAME:
        pixels.flags.writeable = False  # all nodes of a process see the same pixels
        return pixels
    try:
        return np.asarray(cv2.cvtColor(pixels, code or _SAME), np.uint8)
    except cv2.error as error:
        what = f"{msg.encoding} image of {msg.width} x {msg.height} pixels cannot be converted"
        raise ImageError(f"{what}; yuv422 needs an even width, bayer at least 3 x 3 pixels") from error


def depth_to_msg(depth: Float32Array, stamp_ns: int, frame_id: str) -> Image:
    """Return a depth image, (H, W) float32 metres along the optical axis, as 32FC1 (REP-118). Raises ImageError."""
    return image_to_msg(depth, "32FC1", stamp_ns, frame_id)


def msg_to_depth(msg: Any) -> Float32Array:
    """Return a depth Image as (H, W) float32 metres: 32FC1 without a copy, 16UC1 from millimetres with 0 as NaN.

    Source: REP-118. Raises ImageError as `msg_to_array`."""
    pixels = msg_to_array(msg, DEPTH_ENCODINGS)
    if msg.encoding == "32FC1":
        return pixels
    metres = pixels.astype(np.float32) / np.float32(1000)
    metres[pixels == 0] = np.nan
    return metres


def compressed_to_msg(data: bytes, encoding: str, stamp_ns: int, frame_id: str) -> CompressedImage:
    """JPEG or PNG bytes as they are. Raises ImageError where `data` does not begin like `encoding`."""
    found = image_format(data)
    if not found or found != encoding:
        what = f"{len(data)} bytes given as {encoding!r} begin with {data[:8].hex(' ') or 'nothing'}"
        raise ImageError(f"{what}: that is {found or 'neither jpeg nor png'}")
    msg = CompressedImage(header=make_header(stamp_ns, frame_id), format=encoding, check_fields=True)
    buffer = byte_array("B")
    buffer.frombytes(data)
    msg.data = buffer
    return msg


def encode_rgb(image: UInt8Array, encoding: str = "jpeg", quality: int = 92) -> bytes:
    """(H, W, 3) uint8 RGB as JPEG (of `quality` 1..100) or PNG bytes. Raises ImageError."""
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8 or 0 in image.shape:
        raise ImageError(f"an image to compress must be (H, W, 3) uint8, got {image.shape} {image.dtype}")
    if encoding not in ("jpeg", "png") or not 1 <= quality <= 100:
        raise ImageError(f"images are 'jpeg' with quality 1..100 or 'png', not {encoding!r} with {quality}")
    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if encoding == "jpeg" else []
    done, encoded = cv2.imencode(f".{encoding}", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)
    if not done:
        raise ImageError(f"OpenCV could not write {image.shape} as {encoding}")
    return bytes(encoded.tobytes())


def compressed_to_rgb(msg: Any) -> UInt8Array:
    """Return a CompressedImage (jpeg or png, detected by its bytes) as (H, W, 3) uint8 RGB.

    Raises ImageError with format and size when the data is neither, or is incomplete or damaged."""
    return decode_rgb(_as_sent(bytes(memoryview(msg.data)), _named(msg)), _named(msg))


def compressed_size(msg: Any) -> tuple[int, int]:
    """Return the stated (width, height) of a CompressedImage, without decoding it. Raises ImageError."""
    return picture_size(bytes(memoryview(msg.data)), _named(msg))


def picture_size(data: bytes, what: str = "picture") -> tuple[int, int]:
    """Like `compressed_size`, for JPEG or PNG bytes."""
    return stated_size(_as_sent(data, what), what)


def _spec(encoding: str, taken: tuple[str, ...], purpose: str) -> _Encoding:
    if encoding not in taken or encoding not in ENCODINGS:
        raise ImageError(f"image encoding {encoding!r} is not supported {purpose}; supported: {', '.join(taken)}")
    return ENCODINGS[encoding]


def _named(msg: Any) -> str:
    return f"CompressedImage with format {msg.format!r}"


def _as_sent(data: bytes, what: str) -> bytes:
    """Return the same bytes. Raises ImageError if they are in another format than cameras send."""
    if not image_format(data):
        found = f"{len(data)} bytes, beginning {data[:8].hex(' ') or 'with nothing'}"
        raise ImageError(f"{what} ({found}) is neither jpeg nor png; publish one of these, or raw images")
    return data
