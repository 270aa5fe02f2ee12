"""Makes MP4 files box by box (ISO 14496-12, QuickTime File Format): JPEG frames, and telemetry beside them."""

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
    frames: Sequence[UInt8Array],
    fps: int = 2,
    created: datetime | None = None,
    telemetry: Sequence[bytes] = (),
    location: str = "",
    turned: int = 0,
) -> bytes:
    """`telemetry`: packets of a `gpmd` track, one a second. `location`: ISO 6709, as phones write it. `turned`: degrees
    clockwise by which players turn the frames. Without `created` the date is 0, that of a camera without a clock."""
    pictures = [jpeg(frame) for frame in frames]
    height, width = frames[0].shape[:2]
    since_1904 = round((created - datetime(1904, 1, 1, tzinfo=UTC)).total_seconds()) if created is not None else 0
    head = box(b"ftyp", b"mp42", struct.pack(">I", 0), b"mp42isom")
    offset = len(head) + 8
    data = b"".join([*pictures, *telemetry])
    tracks = [_video(pictures, offset, width, height, fps, since_1904, turned)]
    if telemetry:
        tracks.append(_gpmd(telemetry, offset + sum(map(len, pictures)), since_1904))
    mvhd = full(
        b"mvhd",
        struct.pack(">IIII", since_1904, since_1904, 1000, len(frames) * 1000 // fps),
        struct.pack(">IH10x", 0x10000, 0x100),
        _matrix(0),
        bytes(24),
        struct.pack(">I", 3),
    )
    place = box(b"\xa9xyz", struct.pack(">HH", len(location), 0x15C7), location.encode()) if location else b""
    return head + box(b"mdat", data) + box(b"moov", mvhd, *tracks, box(b"udta", place) if location else b"")


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


def _gpmd(samples: Sequence[bytes], offset: int, date: int) -> bytes:
    entry = box(b"gpmd", struct.pack(">6xH", 1), struct.pack(">I", 0))
    return _track(2, b"meta", entry, full(b"gmhd", b""), samples, offset, 1000, 1000, (0, 0), date, 0)


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


def klv(key: bytes, kind: str, size: int, repeat: int, data: bytes) -> bytes:
    """One entry of GPMF, padded to four bytes; an empty `kind` nests."""
    assert len(data) == size * repeat
    return struct.pack(">4sBBH", key, ord(kind) if kind else 0, size, repeat) + data + bytes(-len(data) % 4)


def nest(key: bytes, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return klv(key, "", 1, len(body), body) if len(body) < 65_536 else klv(key, "", 4, len(body) // 4, body)


def gps5(
    fixes: Sequence[tuple[float, float, float]], clock: str, dop: float = 1.5, fix: int = 3, datum: bytes = b""
) -> bytes:
    """A packet as HERO 5 to 10 write it: `fixes` of latitude, longitude, altitude; `clock`: yymmddhhmmss.sss."""
    scale = (10_000_000, 10_000_000, 1000, 1000, 100)
    rows = b"".join(
        struct.pack(">5i", *(round(v * s) for v, s in zip((*row, 1.2, 1.3), scale, strict=True))) for row in fixes
    )
    parts = [
        klv(b"STNM", "c", 1, 7, b"GPS lat"),
        klv(b"GPSF", "L", 4, 1, struct.pack(">I", fix)),
        klv(b"GPSU", "U", 16, 1, clock.encode().ljust(16, b"\0")),
        klv(b"GPSP", "S", 2, 1, struct.pack(">H", round(dop * 100))),
        klv(b"SCAL", "l", 4, 5, struct.pack(">5i", *scale)),
        klv(b"GPS5", "l", 20, len(fixes), rows),
    ]
    if datum:
        parts.insert(3, klv(b"GPSA", "F", 4, 1, datum))
    return nest(b"DEVC", klv(b"DVNM", "c", 1, 6, b"Camera"), _gyro(), nest(b"STRM", *parts))


def gps9(fixes: Sequence[tuple[float, float, float]], days: int, seconds: float, dop: float = 1.5) -> bytes:
    """A packet as HERO 11 and later write it."""
    scale = (10_000_000, 10_000_000, 1000, 1000, 100, 1, 1000, 100, 1)
    rows = b"".join(
        struct.pack(
            ">7i2H",
            *(
                round(v * s)
                for v, s in zip((*row, 1.2, 1.3, days, seconds + k / len(fixes), dop, 3), scale, strict=True)
            ),
        )
        for k, row in enumerate(fixes)
    )
    parts = (
        klv(b"TYPE", "c", 1, 9, b"lllllllSS"),
        klv(b"SCAL", "l", 4, 9, struct.pack(">9i", *scale)),
        klv(b"GPS9", "?", 32, len(fixes), rows),
    )
    return nest(b"DEVC", nest(b"STRM", *parts))


def _gyro() -> bytes:
    """What stands between, of another kind and an odd length."""
    return nest(b"STRM", klv(b"SCAL", "s", 2, 1, struct.pack(">h", 418)), klv(b"GYRO", "s", 6, 3, bytes(18)))
