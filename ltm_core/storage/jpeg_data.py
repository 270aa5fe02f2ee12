"""Parse the structure of a JPEG (ITU-T T.81, annex B), to detect missing data."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import shake_128
from typing import Self

import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Int64Array

_SOS, _DRI = 0xDA, 0xDD
_PROGRESSIVE = 0xC2
_PROCESSES = (0xC0, 0xC1, _PROGRESSIVE)
"""Supported frame headers: of lossy images with Huffman codes; missing arithmetic codes cannot be detected."""
_END = b"\xff\xd9"
_NO_FRAMES = {0xC4, 0xC8, 0xCC}
"""Markers between those of frame headers that are none."""
_RESTART = re.compile(rb"\xff+([\xd0-\xd7])")
_OTHER_DATA = shake_128(b"other data").digest(1 << 16).replace(b"\xff", b"")
"""Bytes that decode to blocks that are not of one grey."""
_MOST_OTHER = 4 << 20
"""Maximum of such bytes in a JPEG, which may have thousands of restart intervals."""


@dataclass(frozen=True)
class Jpeg:
    """Structure of a JPEG. `process`: marker of its frame header. `mcus`: number of coded units. `interval`: coded
    units between restart markers; 0: none. `scans`: (first, last) byte of the data of each. `end`: of the last scan's
    data. `unfinished`: share of the coefficients that no scan completes."""

    width: int
    height: int
    process: int
    components: int
    mcus: int
    interval: int
    scans: tuple[tuple[int, int], ...]
    end: int
    unfinished: float

    @classmethod
    def of(cls, data: bytes, what: str, header_only: bool = False) -> Self:
        """Read the structure up to the end of the image. Raises ImageError without a frame header, or for a process
        that is not supported."""
        frame, ids, process, interval, end = b"", b"", 0, 0, 0
        scans: list[tuple[int, int]] = []
        unfinished = np.ones((0, 64), np.bool_)
        for marker, first, last in _segments(data):
            part = data[first:last]
            if not frame and 0xC0 <= marker <= 0xCF and marker not in _NO_FRAMES and len(part) >= 9:
                process, frame, ids = marker, part, part[6 : 6 + 3 * part[5] : 3]
                unfinished = np.ones((len(ids), 64), np.bool_)
                if header_only:
                    break
            elif marker == _DRI:
                interval = int.from_bytes(part, "big")
            elif marker == _SOS and len(part) >= 6 and part[-1] & 15 == 0:
                chosen = [number for number, name in enumerate(ids) if name in part[1:-3:2]]
                unfinished[chosen, part[-3] : part[-2] + 1] = False
            elif marker == 0:
                scans.append((first, last))
                end = last
        if not ids:
            raise ImageError(f"{what} is corrupt: its header cannot be read")
        height, width = struct.unpack(">HH", frame[1:5])
        if process not in _PROCESSES or frame[0] != 8:
            raise ImageError(
                f"{what} is a JPEG of {frame[0]} bits with process SOF{process & 15}; supported: baseline and "
                "progressive with 8 bits; save it again"
            )
        sides = [(byte >> 4 or 1, byte & 15 or 1) for byte in frame[7 : 6 + 3 * frame[5] : 3]]
        across, down = (8 * max(side[axis] for side in sides) if len(ids) > 1 else 8 for axis in (0, 1))
        mcus = -(-width // across) * -(-height // down)
        share = float(unfinished.mean())
        return cls(width, height, process, len(ids), mcus, interval, tuple(scans), end, share)

    @property
    def simple(self) -> bool:
        """Return whether blocks without data are grey: one scan with all coefficients, not of printing inks."""
        return len(self.scans) == 1 and self.unfinished == 0 and self.process != _PROGRESSIVE and self.components <= 3

    def alone(self, data: bytes) -> bytes:
        """Return the image's own bytes: without what follows it, and with an end marker."""
        return data if data.endswith(_END) and len(data) == self.end + 2 else data[: self.end] + _END

    def restarts_as_expected(self, data: bytes) -> bool:
        """Return whether no restart marker of the first scan is missing."""
        found = [mark[1][0] - 0xD0 for mark in _RESTART.finditer(data, *self.scans[0])]
        wanted = -(-self.mcus // self.interval) - 1 if self.interval else 0
        return found[:wanted] == [number % 8 for number in range(wanted)]

    def with_other_data(self, data: bytes) -> bytes:
        """Return the JPEG with other bytes after the data of each scan and restart interval: the pixels stay the same
        if nothing is missing there."""
        pieces, at = [], 0
        count = len(self.scans) + sum(1 for part in self.scans for _ in _RESTART.finditer(data, *part))
        other = _OTHER_DATA[: max(64, _MOST_OTHER // count)]
        for first, last in self.scans:
            scan = _RESTART.sub(lambda mark: other + mark[0], data[first:last].rstrip(b"\xff"))
            pieces += [data[at:first], scan, other]
            at = last
        return b"".join((*pieces, _END))


def _segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield marker, first and last byte of each segment's content; marker 0 is the data of a scan. Ends at the end of
    the image, at the start of another one, and at a byte that is no marker in a JPEG."""
    at, ends = 2, None
    while (at := data.find(b"\xff", at) + 1) > 0 and at < len(data):
        marker = data[at]
        if marker in (0x00, 0xFF):
            continue  # fill bytes, and bytes that do not belong there
        if marker in (0xD8, 0xD9) or 0x01 < marker < 0xC0:
            return
        at += 1
        if 0xD0 <= marker <= 0xD7 or marker == 0x01:
            continue
        last = at + max(2, int.from_bytes(data[at : at + 2], "big"))
        yield marker, at + 2, last
        at = last
        if marker == _SOS:
            ends = _scan_ends(data) if ends is None else ends
            end = int(ends[np.searchsorted(ends, at)]) if at <= ends[-1] else len(data)
            yield 0, at, end
            at = end


def _scan_ends(data: bytes) -> Int64Array:
    """Return the places where scan data may end: markers other than restarts, and the end without zeros from an
    incomplete copy. A regular expression takes ten times as long."""
    values = np.frombuffer(data, np.uint8)
    at = np.flatnonzero(values[:-1] == 0xFF)
    code = values[at + 1]
    at = at[(code > 0) & (code < 0xFF) & ((code & 0xF8) != 0xD0)]
    return np.append(at, max(len(data.rstrip(b"\0")), at[-1] + 1 if at.size else 0))
