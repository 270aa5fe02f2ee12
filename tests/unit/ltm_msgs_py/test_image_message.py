from array import array
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image

from ltm_core.base.errors import ImageError
from ltm_core.base.types import UInt8Array
from ltm_msgs_py.image import (
    ENCODINGS,
    compressed_to_msg,
    compressed_to_rgb,
    decode_rgb,
    encode_rgb,
    image_to_msg,
    msg_to_array,
    msg_to_depth,
    msg_to_rgb,
)

H, W = 11, 17


def pixels(encoding: str) -> NDArray[Any]:
    spec = ENCODINGS[encoding]
    shape = (H, W) if spec.channels == 1 else (H, W, spec.channels)
    rng = np.random.default_rng(3)
    if spec.dtype.kind == "f":
        return (rng.random(shape) * 5000).astype(spec.dtype)
    return rng.integers(0, np.iinfo(spec.dtype).max + 1, shape, dtype=spec.dtype)


def raw_message(data: bytes, encoding: str, height: int, width: int, step: int, big: bool = False) -> Image:
    msg = Image(height=height, width=width, encoding=encoding, step=step, is_bigendian=int(big))
    msg.data = array("B", data)
    return msg


def test_strided_images_are_written_in_their_own_order() -> None:
    image = pixels("rgb8")[::-1, ::2]
    np.testing.assert_array_equal(msg_to_rgb(image_to_msg(image, "rgb8", 0, "")), image)


def test_rgb8_and_32fc1_are_read_without_a_copy() -> None:
    rgb = image_to_msg(pixels("rgb8"), "rgb8", 0, "")
    depth = image_to_msg(pixels("32FC1"), "32FC1", 0, "")
    assert np.shares_memory(msg_to_rgb(rgb), np.frombuffer(rgb.data, np.uint8))
    assert np.shares_memory(msg_to_depth(depth), np.frombuffer(depth.data, np.uint8))


def test_colours_land_in_their_channels() -> None:
    colour = np.array([[[10, 20, 30], [40, 50, 60]]], np.uint8)
    alpha = np.full((1, 2, 1), 99, np.uint8)
    bgr = np.ascontiguousarray(colour[..., ::-1])
    for encoding, image in {
        "rgb8": colour,
        "bgr8": bgr,
        "rgba8": np.dstack([colour, alpha]),
        "bgra8": np.dstack([bgr, alpha]),
        "8UC3": bgr,
    }.items():
        np.testing.assert_array_equal(msg_to_rgb(image_to_msg(image, encoding, 0, "")), colour, err_msg=encoding)


def test_grey_goes_to_all_channels_and_mono16_keeps_its_high_byte() -> None:
    grey = np.array([[0, 7, 255]], np.uint8)
    expected = np.repeat(grey[..., None], 3, axis=2)
    np.testing.assert_array_equal(msg_to_rgb(image_to_msg(grey, "mono8", 0, "")), expected)
    deep = grey.astype(np.uint16) * 256 + 255
    for encoding in ("mono16", "16UC1"):
        np.testing.assert_array_equal(msg_to_rgb(image_to_msg(deep, encoding, 0, "")), expected)


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("bits", [8, 16])
def test_bayer_patterns_give_each_colour(pattern: str, bits: int) -> None:
    colour = {"r": 200, "g": 90, "b": 20}
    tile = np.array([colour[name] for name in pattern], np.uint8).reshape(2, 2)
    mosaic = np.tile(tile, (4, 5))
    if bits == 16:
        mosaic = mosaic.astype(np.uint16) * 256 + 77
    seen = msg_to_rgb(image_to_msg(mosaic, f"bayer_{pattern}{bits}", 0, ""))
    np.testing.assert_array_equal(seen, np.broadcast_to(np.array([200, 90, 20], np.uint8), (8, 10, 3)))


@pytest.mark.parametrize(
    ("encoding", "order"), [("yuv422", "uyvy"), ("uyvy", "uyvy"), ("yuv422_yuy2", "yuyv"), ("yuyv", "yuyv")]
)
def test_yuv_of_two_pixels_shares_colour(encoding: str, order: str) -> None:
    """ITU-R BT.601, limited range: two pixels of red with different brightness."""
    values = {"u": 90, "v": 200}
    row, luma = [], iter((82, 141, 82, 141))
    for name in order * 2:
        row.append(next(luma) if name == "y" else values[name])
    seen = msg_to_rgb(image_to_msg(np.array(row, np.uint8).reshape(1, 4, 2).repeat(2, axis=0), encoding, 0, ""))
    for n, y in enumerate((82, 141)):
        r = 1.164 * (y - 16) + 1.596 * (200 - 128)
        g = 1.164 * (y - 16) - 0.392 * (90 - 128) - 0.813 * (200 - 128)
        b = 1.164 * (y - 16) + 2.017 * (90 - 128)
        np.testing.assert_allclose(seen[0, n], np.clip([r, g, b], 0, 255), atol=1.5)
    with pytest.raises(ImageError):
        msg_to_rgb(raw_message(bytes(12), encoding, 2, 3, 6))


@pytest.mark.parametrize("encoding", ["rgb8", "mono16", "32FC1", "32FC3"])
@pytest.mark.parametrize("padding", [4, 3])
def test_row_padding_is_cut_off(encoding: str, padding: int) -> None:
    image = pixels(encoding)
    rows = [row.tobytes() + b"\xee" * padding for row in image]
    msg = raw_message(b"".join(rows), encoding, H, W, len(rows[0]))
    np.testing.assert_array_equal(msg_to_array(msg), image)


@pytest.mark.parametrize("encoding", ["mono16", "16UC1", "32FC1", "32FC3"])
def test_big_endian_images_come_out_native(encoding: str) -> None:
    image = pixels(encoding)
    swapped = image.astype(image.dtype.newbyteorder(">"))
    back = msg_to_array(raw_message(swapped.tobytes(), encoding, H, W, image.strides[0], big=True))
    assert back.dtype.isnative
    np.testing.assert_array_equal(back, image)


def test_depth_in_millimetres_becomes_metres_with_zero_unknown() -> None:
    msg = image_to_msg(np.array([[0, 1500, 65535]], np.uint16), "16UC1", 0, "")
    np.testing.assert_allclose(msg_to_depth(msg), np.float32([[np.nan, 1.5, 65.535]]), rtol=1e-7)


@pytest.mark.parametrize("encoding", ["nv12", "64FC1", "", "32FC1", "rgb8; jpeg"])
def test_colour_encodings_not_taken_are_named_with_those_that_are(encoding: str) -> None:
    with pytest.raises(ImageError, match="supported: rgb8, bgr8") as caught:
        msg_to_rgb(raw_message(bytes(12), encoding, 1, 1, 12))
    assert repr(encoding) in str(caught.value)


@pytest.mark.parametrize(
    ("height", "width", "step", "size"),
    [
        (H, W, W * 3, H * W * 3 - 1),
        (H, W, W * 3, H * W * 3 + 1),
        (H, W, W * 3 - 1, H * (W * 3 - 1)),
        (H, W, 0, 0),
        (0, W, W * 3, 0),
        (H, 0, 0, 0),
        (-H, -W, W * 3, H * W * 3),
        (2**32 - 1, 2**32 - 1, 2**32 - 1, 12),
    ],
)
def test_sizes_that_lie_are_refused(height: int, width: int, step: int, size: int) -> None:
    with pytest.raises(ImageError, match=f"{width} x {height} with step {step} holds {size} bytes"):
        msg_to_rgb(raw_message(bytes(size), "rgb8", height, width, step))


@pytest.mark.parametrize(
    ("image", "encoding"),
    [
        (np.zeros((H, W), np.uint8), "rgb8"),
        (np.zeros((H, W, 4), np.uint8), "rgb8"),
        (np.zeros((H, W, 3), np.float32), "rgb8"),
        (np.zeros((H, W), np.float64), "32FC1"),
        (np.zeros((0, W), np.uint8), "mono8"),
        (np.zeros((H, W, 1), np.uint8), "mono8"),
    ],
)
def test_arrays_that_do_not_fit_their_encoding_are_refused(image: NDArray[Any], encoding: str) -> None:
    with pytest.raises(ImageError, match=encoding):
        image_to_msg(image, encoding, 0, "")


def smooth() -> UInt8Array:
    v, u = np.mgrid[0:48, 0:80]
    return np.stack([u * 3, v * 5, 255 - u * 2], axis=-1).astype(np.uint8)


def test_png_is_exact_and_jpeg_close() -> None:
    image = smooth()
    png = compressed_to_msg(encode_rgb(image, "png"), "png", 7, "c")
    np.testing.assert_array_equal(compressed_to_rgb(png), image)
    jpeg = compressed_to_rgb(compressed_to_msg(encode_rgb(image, "jpeg", 95), "jpeg", 7, "c"))
    assert np.abs(jpeg.astype(int) - image).mean() < 3
    assert png.header.stamp.nanosec == 7


@pytest.mark.parametrize("data", [b"", b"\xff\xd8", bytes(500), b"GIF89a" + bytes(50), b"\x00" * 12 + b"\x89PNG"])
def test_what_is_neither_jpeg_nor_png_is_refused(data: bytes) -> None:
    msg = CompressedImage(format="16UC1; compressedDepth png")
    msg.data = array("B", data)
    with pytest.raises(ImageError, match=rf"compressedDepth png' \({len(data)} bytes.*neither jpeg nor png"):
        compressed_to_rgb(msg)
    with pytest.raises(ImageError, match=f"{len(data)} bytes"):
        compressed_to_msg(data, "jpeg", 0, "")


def test_a_jpeg_of_many_scans_is_not_decoded() -> None:
    """Each scan is a walk over all pixels: a few kilobytes of them took minutes."""
    jpeg = encode_rgb(np.zeros((16, 24, 3), np.uint8), "jpeg")
    scan = b"\xff\xda\x00\x08\x01\x01\x00\x00\x3f\x00\x00"
    with pytest.raises(ImageError, match=r"has \d+ scans"):
        decode_rgb(jpeg[:-2] + scan * 300 + jpeg[-2:])
