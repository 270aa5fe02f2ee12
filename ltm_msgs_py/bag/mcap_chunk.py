"""Read the chunks of MCAP files, within limits of memory."""

from __future__ import annotations

import struct
from dataclasses import replace
from io import BytesIO
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, McapRecord
from mcap.stream_reader import breakup_chunk
from zstandard import ZstdError

RECORD_HEAD = struct.Struct("<BQ")
_CHUNK_OPCODES = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, *range(128, 256)}
LARGEST_MESSAGE = 128 << 20
"""Maximum bytes of a message or chunk: recorders write chunks of a few megabytes, or of one larger message."""
_RECORDS_BESIDE = 1000
"""Maximum number of records of a chunk beyond one per compressed byte; recorded ones take ten bytes and more."""

BROKEN = (
    *(McapError, ZstdError, struct.error, ValueError, LookupError),
    *(RuntimeError, EOFError, MemoryError, OverflowError, OSError),
)
"""Exceptions of the mcap library and its dependencies for corrupt bytes."""


def read_chunk(stream: BinaryIO, offset: int) -> Chunk:
    """Return the chunk record at an offset. Raises what `BROKEN` names."""
    size = stream.seek(0, 2)
    stream.seek(offset)
    opcode, length = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
    if opcode != Opcode.CHUNK or offset + length > size:
        raise ValueError(f"expected a chunk within {size} bytes, found opcode {opcode} of {length} bytes")
    if length > LARGEST_MESSAGE:
        raise ValueError(f"chunk has {length} bytes, more than {LARGEST_MESSAGE}")
    return Chunk.read(ReadDataStream(BytesIO(stream.read(length))))


def records_of(chunk: Chunk) -> list[McapRecord]:
    """Return a chunk's records. Raises what `BROKEN` names, before more than `LARGEST_MESSAGE` bytes and one record per
    compressed byte: a hundred kilobytes may expand to gigabytes, or to millions of empty records."""
    whole = _decompressed(chunk)
    most, count, at = len(chunk.data) + _RECORDS_BESIDE, 0, 0
    while at < len(whole):
        opcode, length = RECORD_HEAD.unpack_from(whole, at)
        count += 1
        if opcode not in _CHUNK_OPCODES or count > most:
            raise ValueError(f"record {count} of the chunk has opcode {opcode}; at most {most} records are read")
        at += RECORD_HEAD.size + length
    plain = replace(chunk, compression="", data=whole, uncompressed_size=len(whole))
    return list(breakup_chunk(plain, validate_crc=True))


def _decompressed(chunk: Chunk) -> bytes:
    """Return a chunk's records as bytes. mcap's own function allocates what a zstd frame states, and has no limit for
    lz4."""
    stated = chunk.uncompressed_size
    if chunk.compression == "zstd":
        stated = max(stated, zstandard.frame_content_size(chunk.data))
    if stated > LARGEST_MESSAGE:
        raise ValueError(f"chunk states a size of {stated} bytes, more than {LARGEST_MESSAGE}")
    match chunk.compression:
        case "":
            return bytes(chunk.data)
        case "zstd":
            return bytes(zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=stated))
        case "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=stated))
    raise ValueError(f"unknown compression {chunk.compression!r}; zstd, lz4 and none are supported")
