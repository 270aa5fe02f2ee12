"""Pictures that were made to harm."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import pytest
from PIL import Image

from ltm_core.base.errors import ImageError
from ltm_core.storage.text_io import check_picture, open_picture


def png_of(width: int, height: int) -> bytes:
    """The head of a PNG that states a size, and nothing of its pixels."""

    def chunk(kind: bytes, body: bytes = b"") -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT") + chunk(b"IEND")


def test_a_picture_is_refused_by_the_size_that_it_states(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(png_of(30_000, 2_500))
    with pytest.raises(ImageError, match=r"a\.png: states a size of 30000 x 2500: more than 64 million pixels"):
        check_picture(tmp_path / "a.png")
    (tmp_path / "b.png").write_bytes(png_of(40, 25))
    check_picture(tmp_path / "b.png")


@pytest.mark.parametrize(
    "raised", [EOFError("no more"), RuntimeError("odd"), TypeError("odd"), struct.error("odd"), KeyError(3)]
)
def test_whatever_pillow_raises_is_an_image_error(tmp_path: Path, raised: Exception) -> None:
    """EXIF and HEIC that are damaged raised each of these, out of the block that reads them."""
    Image.new("RGB", (4, 3)).save(tmp_path / "a.png")
    with (
        pytest.raises(ImageError, match=rf"a\.png: cannot be read as an image \({type(raised).__name__}"),
        open_picture(tmp_path / "a.png"),
    ):
        raise raised


def test_programs_are_not_started_for_a_picture(tmp_path: Path) -> None:
    """Pillow hands EPS to Ghostscript."""
    Image.new("RGB", (4, 3)).save(tmp_path / "a.eps")
    (tmp_path / "a.eps").rename(tmp_path / "a.jpg")
    with pytest.raises(ImageError, match="unsupported format"):
        check_picture(tmp_path / "a.jpg")


def test_a_png_chunk_longer_than_the_file_is_refused(tmp_path: Path) -> None:
    """OpenCV, which decodes what was checked, would take the gigabyte that such a chunk states."""
    Image.new("I;16", (14, 9), 800).save(tmp_path / "a.png")
    check_picture(tmp_path / "a.png")
    content = bytearray((tmp_path / "a.png").read_bytes())
    at = content.index(b"IDAT") - 4
    content[at : at + 4] = (0x40000110).to_bytes(4, "big")
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ImageError, match=r"a\.png \(\d+ bytes\) is truncated: its chunks state more bytes than it has"):
        check_picture(tmp_path / "a.png")
