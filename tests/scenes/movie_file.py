"""Makes MP4 files of JPEG frames, box by box (ISO 14496-12, QuickTime File Format)."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np
from PIL import Image

from ltm_core.base.types import UInt8Array

_MATRICES = {
    0: (1, 0, 0, 1),
    90: (0, 1, -1, 0),  # shown turned clockwise by a quarter
    180: (-1, 0, 0, -1),
    270: (0, -1, 1, 0),
}


def box(kind: bytes, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I4s", 8 + len(body), kind) + body


def full(kind: bytes, *parts: bytes, version: int = 0, flags: int = 0) -> bytes:
    return box(kind, struct.pack(">I", version << 24 | flags), *parts)


def jpeg(image: UInt8Array) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=95, subsampling=0)
    return file.getvalue()


def movie(
    frames: Sequence[UInt8Array], fps: int = 2, created: datetime | None = None, location: str = "", turned: int = 0
) -> bytes:
    """`location`: ISO 6709, as phones write it. `turned`: degrees clockwise by which players turn the frames. Without
    `created` the date is 0, that of a camera without a clock."""
    pictures = [jpeg(frame) for frame in frames]
    height, width = frames[0].shape[:2]
    since_1904 = round((created - datetime(1904, 1, 1, tzinfo=UTC)).total_seconds()) if created is not None else 0
    head = box(b"ftyp", b"mp42", struct.pack(">I", 0), b"mp42isom")
    offset = len(head) + 8
    track = _video(pictures, offset, width, height, fps, since_1904, turned)
    mvhd = full(
        b"mvhd",
        struct.pack(">IIII", since_1904, since_1904, 1000, len(frames) * 1000 // fps),
        struct.pack(">IH10x", 0x10000, 0x100),
        _matrix(0),
        bytes(24),
        struct.pack(">I", 3),
    )
    place = box(b"\xa9xyz", struct.pack(">HH", len(location), 0x15C7), location.encode()) if location else b""
    return head + box(b"mdat", b"".join(pictures)) + box(b"moov", mvhd, track, box(b"udta", place) if location else b"")


def _matrix(turned: int) -> bytes:
    a, b, c, d = (v * 0x10000 for v in _MATRICES[turned])
    return struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 0x40000000)


def _video(samples: Sequence[bytes], offset: int, width: int, height: int, fps: int, date: int, turned: int) -> bytes:
    entry = box(
        b"jpeg",
        struct.pack(">6xH", 1),
        struct.pack(">HH4sIIHHIIIH", 0, 0, b"none", 0, 0, width, height, 0x480000, 0x480000, 0, 1),
        bytes(32),
        struct.pack(">Hh", 24, -1),
    )
    media = full(b"vmhd", bytes(8), flags=1)
    return _track(1, b"vide", entry, media, samples, offset, fps, 1, (width, height), date, turned)


def _track(
    number: int,
    handler: bytes,
    entry: bytes,
    media: bytes,
    samples: Sequence[bytes],
    offset: int,
    scale: int,
    ticks: int,
    size: tuple[int, int],
    date: int,
    turned: int,
) -> bytes:
    count, offsets = len(samples), offset + np.cumsum([0, *map(len, samples[:-1])])
    tables = box(
        b"stbl",
        full(b"stsd", struct.pack(">I", 1), entry),
        full(b"stts", struct.pack(">III", 1, count, ticks)),
        full(b"stsc", struct.pack(">IIII", 1, 1, 1, 1)),
        full(b"stsz", struct.pack(">II", 0, count), *(struct.pack(">I", len(sample)) for sample in samples)),
        full(b"stco", struct.pack(">I", count), *(struct.pack(">I", int(at)) for at in offsets)),
    )
    reference = box(b"dinf", full(b"dref", struct.pack(">I", 1), full(b"url ", b"", flags=1)))
    tkhd = full(
        b"tkhd",
        struct.pack(">IIIII8xHHHH", date, date, number, 0, count * ticks * 1000 // scale, 0, 0, 0, 0),
        _matrix(turned),
        struct.pack(">II", size[0] << 16, size[1] << 16),
        flags=7,
    )
    mdia = box(
        b"mdia",
        full(b"mdhd", struct.pack(">IIIIHH", date, date, scale, count * ticks, 0x55C4, 0)),
        full(b"hdlr", b"mhlr", handler, bytes(12), b"maker\0"),
        box(b"minf", media, reference, tables),
    )
    return box(b"trak", tkhd, mdia)
