import ast
import re
import struct
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pillow_heif
import pytest
from PIL import Image, ImageOps

from ltm_core.base.errors import ImageError
from ltm_core.base.types import UInt8Array
from ltm_core.storage.image_io import decode_rgb, opened_picture, read_rgb, stated_size, without_tail

REPOSITORY = Path(__file__).parents[4]
END = b"\xff\xd9"


def scene(height: int = 240, width: int = 320) -> UInt8Array:
    """Return an image with a third of mid-grey, the colour that libjpeg fills in."""
    v, u = np.mgrid[:height, :width]
    noise = np.random.default_rng(0).integers(0, 30, (height, width, 3))
    image = np.stack([u % 200, v % 200, (u + v) % 200], axis=-1) + noise
    image[:, : width // 3] = 128
    return image.astype(np.uint8)


def encoded(form: str = "JPEG", image: UInt8Array | None = None, mode: str = "RGB", **options: Any) -> bytes:
    pillow_heif.register_heif_opener()
    stream = BytesIO()
    Image.fromarray(scene() if image is None else image).convert(mode).save(stream, form, **options)
    return stream.getvalue()


JPEGS: dict[str, dict[str, Any]] = {
    "4:2:0": {},
    "4:4:4": {"subsampling": 0},
    "4:2:2": {"subsampling": 1, "optimize": True},
    "restarts": {"restart_marker_rows": 1},
    "many restarts": {"restart_marker_blocks": 1},
    "progressive": {"progressive": True},
    "progressive restarts": {"progressive": True, "restart_marker_rows": 2},
    "grey": {"mode": "L"},
    "inks": {"mode": "CMYK"},
}


def rejected(data: bytes, reduced: int = 1) -> None:
    with pytest.raises(ImageError, match="truncated or corrupt"):
        decode_rgb(data, "image", reduced)


def missing_share(data: bytes) -> float:
    """Return the share that the error states."""
    with pytest.raises(ImageError, match=r"is truncated") as error:
        decode_rgb(data)
    found = re.search(r"([\d.]+)\s?%", str(error.value))
    assert found
    return float(found[1]) / 100


def cut(data: bytes, kept: float) -> bytes:
    """Return a JPEG with this share of the data of all scans together."""
    first = data.index(b"\xff\xda") + 14
    return data[: first + round((len(data) - first) * kept)]


@pytest.mark.parametrize(("kept", "end"), [(0.3, b""), (0.6, b"\xff" + END), (0.96, bytes(5000))])
@pytest.mark.parametrize("kind", JPEGS)
def test_a_jpeg_whose_data_end_early_is_rejected(kind: str, kept: float, end: bytes) -> None:
    rejected(cut(encoded(**JPEGS[kind]), kept) + end)


def wrong_scan_parameters(data: bytes) -> bytes:
    """Return a baseline JPEG whose scan states no coefficients, as some cameras write it."""
    end = data.index(b"\xff\xda") + 14
    return data[: end - 2] + b"\0" + data[end - 1 :]


def later_version(data: bytes) -> bytes:
    at = data.index(b"JFIF\0") + 5
    return data[:at] + b"\2" + data[at + 1 :]


ODD = [wrong_scan_parameters, later_version, lambda data: data[:20] + bytes(7) + data[20:]]


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("end", [b"", END])
def test_a_harmless_oddity_does_not_hide_missing_data(odd: Callable[[bytes], bytes], end: bytes) -> None:
    """Libjpeg reports the first warning only."""
    whole = encoded()
    np.testing.assert_array_equal(decode_rgb(odd(whole)), decode_rgb(whole))
    rejected(cut(odd(whole), 0.6) + end)


def test_data_that_come_twice_are_rejected() -> None:
    whole = encoded()
    middle = len(whole) // 2
    rejected(whole[:middle] + whole[middle - 3000 :])


@pytest.mark.parametrize("reduced", [2, 4, 8])
def test_a_reduced_image_is_checked_too(reduced: int) -> None:
    data = encoded()
    assert decode_rgb(data, "image", reduced).shape == (240 // reduced, 320 // reduced, 3)
    rejected(cut(data, 0.6) + END, reduced)


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data + b"trailing garbage" + bytes(40),
        lambda data: data + bytes(4000),
        lambda data: data[:-2],
        lambda data: data[:-2] + b"\xff\xff\xff" + END,
        lambda data: data[:-2] + b"extraneous" + END,
        lambda data: data + encoded(quality=20),
        lambda data: data + b"\0\0\0\x18ftypmp42" + bytes(range(256)) * 9 + END,
        lambda data: data + b"\0\0\0\x18ftypmp42" + b"\xff\xda\xff\xc9" * 300,
        lambda data: data[:2] + b"\xff\xe1\x00\x06\xff\xd9\xff\xda" + data[2:],
    ],
    ids=["garbage", "zeros", "no end", "fill", "extra", "second image", "video", "large video", "markers in a segment"],
)
@pytest.mark.parametrize("kind", ["4:2:0", "many restarts", "progressive", "inks"])
def test_a_complete_jpeg_is_accepted(kind: str, change: Callable[[bytes], bytes]) -> None:
    whole = encoded(**JPEGS[kind])
    np.testing.assert_array_equal(decode_rgb(change(whole)), decode_rgb(whole))
    np.testing.assert_array_equal(decode_rgb(without_tail(change(whole))), decode_rgb(whole))


@pytest.mark.parametrize("progressive", [False, True])
def test_a_missing_restart_interval_is_found(progressive: bool) -> None:
    data = encoded(restart_marker_rows=1, progressive=progressive)
    marks = [m.start() for m in re.finditer(rb"\xff[\xd0-\xd7]", data)]
    rejected(data[: marks[4] + 2] + data[marks[5] :])
    rejected(data[: marks[4]] + data[marks[5] :])


@pytest.mark.parametrize("kept", [0.3, 0.97])
@pytest.mark.parametrize("zeros", [False, True])
@pytest.mark.parametrize(("form", "options"), [("HEIF", {}), ("AVIF", {}), ("WEBP", {}), ("WEBP", {"lossless": True})])
def test_other_formats_that_are_cut_are_rejected_with_the_share(
    form: str, options: dict[str, Any], kept: float, zeros: bool
) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (300, 400, 3), np.uint8)
    whole = encoded(form, noise, **options)
    assert decode_rgb(whole).shape == noise.shape
    data = whole[: round(len(whole) * kept)]
    share = missing_share(data + bytes(len(whole) - len(data)) if zeros else data)
    assert share == pytest.approx(1 - kept, abs=0.01)


@pytest.mark.parametrize("kept", [0.3, 0.97])
@pytest.mark.parametrize(
    ("form", "options"), [("PNG", {}), ("TIFF", {}), ("TIFF", {"compression": "tiff_lzw"}), ("GIF", {}), ("BMP", {})]
)
def test_formats_that_state_no_size_are_rejected_when_cut(form: str, options: dict[str, Any], kept: float) -> None:
    whole = encoded(form, **options)
    assert decode_rgb(whole).shape == (240, 320, 3)
    with pytest.raises(ImageError, match="truncated"):
        decode_rgb(whole[: round(len(whole) * kept)])


def chunk(kind: bytes, body: bytes = b"") -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png_of(width: int, height: int, pixels: bytes = b"") -> bytes:
    """Return a PNG that states a size, with these rows."""
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", pixels) + chunk(b"IEND")


def test_an_image_is_rejected_by_the_size_that_it_states() -> None:
    jpeg = bytearray(encoded())
    at = jpeg.index(b"\xff\xc0")
    jpeg[at + 5 : at + 9] = struct.pack(">HH", 65_000, 65_000)
    for data in (png_of(30_000, 2_500), bytes(jpeg)):
        with pytest.raises(ImageError, match=r"states a size of \d+ x \d+: more than 64 million pixels"):
            decode_rgb(data)
    assert stated_size(png_of(40, 25)) == (40, 25)


def test_a_png_chunk_longer_than_the_file_is_rejected() -> None:
    """OpenCV would allocate the gigabyte that such a chunk states."""
    content = bytearray(encoded("PNG"))
    at = content.index(b"IDAT") - 4
    content[at : at + 4] = (0x40000110).to_bytes(4, "big")
    with pytest.raises(ImageError, match="truncated: its chunks state more bytes than it has"):
        decode_rgb(bytes(content))


def with_frame(process: int, bits: int) -> bytes:
    data = bytearray(encoded())
    at = data.index(b"\xff\xc0")
    data[at + 1], data[at + 4] = process, bits
    return bytes(data)


def animation(form: str) -> bytes:
    stream, frames = BytesIO(), [Image.fromarray(scene()), Image.fromarray(scene()[::-1])]
    frames[0].save(stream, form, save_all=True, append_images=frames[1:])
    return stream.getvalue()


def dng() -> bytes:
    """Return a TIFF of a preview, as cameras write it into a raw file."""
    return encoded("TIFF", tiffinfo={50706: b"\1\4\0\0"})


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda: with_frame(0xC1, 12), "corrupt"),
        (lambda: with_frame(0xC9, 8), "corrupt"),
        (lambda: with_frame(0xC3, 8), "corrupt"),
        (dng, "raw photo"),
        (lambda: animation("GIF"), "animation"),
        (lambda: animation("WEBP"), "animation"),
        (lambda: encoded("TIFF", np.ones((4, 4), np.float32), "F"), "32-bit"),
        (lambda: b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n", "unsupported format"),
        (lambda: b"<html>login</html>", "unsupported format"),
        (lambda: b"\xff\xd8\xff" + bytes(500), "header cannot be read"),
        (lambda: b"\xff\xd8\xff\xc0\x00\x08\x08\x00\x10\x00\x10\x00" + END, "header cannot be read"),
    ],
)
def test_images_that_cannot_be_checked_or_are_no_photos_are_rejected(make: Callable[[], bytes], why: str) -> None:
    with pytest.raises(ImageError, match=why):
        decode_rgb(make())


@pytest.mark.parametrize("form", ["PNG", "TIFF"])
def test_sixteen_bits_keep_the_high_byte(form: str) -> None:
    stream = BytesIO()
    Image.fromarray(np.arange(0, 65_536, 257, np.uint16).reshape(16, 16)).save(stream, form)
    np.testing.assert_array_equal(decode_rgb(stream.getvalue())[..., 1].ravel(), np.arange(256))


@pytest.mark.parametrize(
    ("form", "turn"), [*(("JPEG", turn) for turn in range(1, 9)), ("PNG", 6), ("TIFF", 7), ("WEBP", 3), ("AVIF", 8)]
)
def test_photos_are_read_upright(tmp_path: Path, form: str, turn: int) -> None:
    exif = Image.Exif()
    exif[0x0112] = turn
    path = tmp_path / "photo"
    Image.fromarray(scene(24, 32)).save(path, form, exif=exif)
    with Image.open(path) as image:
        wanted = np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
    np.testing.assert_array_equal(read_rgb(path), wanted)


def test_heic_is_not_turned_by_its_exif(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x0112] = 6
    pillow_heif.register_heif_opener()
    Image.fromarray(scene(32, 48)).save(tmp_path / "a.heic", exif=exif)
    assert read_rgb(tmp_path / "a.heic").shape == (32, 48, 3)


@pytest.mark.parametrize(
    "raised", [EOFError("no more"), RuntimeError("odd"), TypeError("odd"), struct.error("odd"), KeyError(3)]
)
def test_whatever_pillow_raises_is_an_image_error(raised: Exception) -> None:
    """EXIF and HEIC that are damaged raised each of these, out of the block that reads them."""
    with (
        pytest.raises(ImageError, match=rf"a\.png: cannot be read as an image \({type(raised).__name__}"),
        opened_picture(encoded("PNG"), "a.png"),
    ):
        raise raised


def test_only_one_file_calls_the_libraries_that_decode() -> None:
    decoders = {
        "imdecode",
        "imdecodemulti",
        "imread",
        "imreadmulti",
        "register_heif_opener",
        "open_heif",
        "read_heif",
        "decode_jpeg",
    }
    found = set()
    for top in ("ltm_core", "ltm_msgs_py", "ltm_ros"):
        for path in (REPOSITORY / top).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                call = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
                if call.rpartition(".")[2] in decoders or call.endswith("Image.open"):
                    found.add(path.relative_to(REPOSITORY).as_posix())
    assert found == {"ltm_core/storage/image_io.py"}
