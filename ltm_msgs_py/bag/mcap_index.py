"""Index the messages in one MCAP file, from its summary, or by a scan if it has none.

A killed recorder leaves a file without a summary, truncated inside a record. Everything before that is read; the
position and the reason are reported.
"""

from __future__ import annotations

import errno
import heapq
import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from zstandard import ZstdError

from ltm_core.base.errors import RecordingError

MAGIC = b"\x89MCAP0\r\n"
LATEST_NS = 2**63 - 1
"""Latest time in ns that ROS supports; MCAP's own times go twice as far."""
_OPCODES = {*range(1, 16), *range(128, 256)}  # those of the specification, and those left to its users
_RECORD_HEAD = struct.Struct("<BQ")
_TAIL = struct.Struct("<BQQQI8s")  # the footer record and the closing magic
_CHUNK_OPCODES = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, *range(128, 256)}
_LARGEST_CHUNK = 128 << 20
"""Maximum bytes of a chunk: recorders write chunks of a few megabytes, or of one larger message."""
_LARGEST_SUMMARY = 256 << 20
_MOST_WAITING = 256 << 20
"""Maximum bytes of messages in chunks that overlap in time."""
_RECORDS_BESIDE = 1000
"""Maximum number of records of a chunk beyond one per compressed byte; recorded ones take ten bytes and more."""

# Exceptions of the mcap library and its dependencies for corrupt bytes.
_BROKEN = (
    *(McapError, ZstdError, struct.error, ValueError, LookupError),
    *(RuntimeError, EOFError, MemoryError, OverflowError, OSError),
)


@dataclass(frozen=True, order=True)
class _Entry:
    """A chunk, or a message outside chunks, at a byte offset; `start_ns` to `end_ns` inclusive: its log times."""

    start_ns: int
    offset: int
    end_ns: int
    is_chunk: bool


@dataclass
class McapIndex:
    """The channels of an MCAP file and the positions of its messages.

    `damage`: unreadable parts, with byte offsets; empty for a complete file. `unread`: parts that the system failed to
    read, maybe temporarily. `counts`: messages per channel id.
    """

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    start_ns: int | None = None
    end_ns: int | None = None
    damage: list[str] = field(default_factory=list)
    unread: list[str] = field(default_factory=list)
    _entries: list[_Entry] = field(default_factory=list)

    @classmethod
    def open(cls, path: Path) -> McapIndex:
        """Read a file's index. Raises RecordingError when the file cannot be opened or is no MCAP."""
        index = cls(path)
        try:
            with path.open("rb") as stream:
                magic = stream.read(len(MAGIC))
                if magic != MAGIC:
                    raise RecordingError(_not_mcap(path, magic))
                if not index._read_summary(stream):
                    index._scan(stream)
        except OSError as error:
            raise RecordingError(f"cannot read {path}: {error}") from error
        return index

    def messages(
        self, channel_ids: Collection[int], start_ns: int | None, end_ns: int | None
    ) -> Iterator[tuple[Channel, Message]]:
        """Yield messages of the given channels with start_ns <= log_time < end_ns, by log time, then by position in the
        file.

        Corrupt chunks are skipped and noted in `damage`.
        """
        # A chunk waits in the heap under its first message's time, and its messages join it when it is opened, so at
        # most the chunks that overlap in time are in memory.
        waiting: list[tuple[int, int, int, _Entry | Message]] = [
            (entry.start_ns, entry.offset, -1, entry)
            for entry in self._entries
            if (start_ns is None or entry.end_ns >= start_ns) and (end_ns is None or entry.start_ns < end_ns)
        ]
        heapq.heapify(waiting)
        held = 0
        with self.path.open("rb") as stream:
            while waiting:
                _, offset, _, item = heapq.heappop(waiting)
                if isinstance(item, Message):
                    held -= len(item.data)
                    yield self.channels[item.channel_id], item
                    continue
                wanted = [
                    (message.log_time, offset, place, message)
                    for place, message in enumerate(self._load(stream, item))
                    if message.channel_id in channel_ids
                    and (start_ns is None or message.log_time >= start_ns)
                    and (end_ns is None or message.log_time < end_ns)
                ]
                size = sum(len(message.data) for *_, message in wanted)
                if held and held + size > _MOST_WAITING:
                    overlap = (
                        f"it and others of the same time hold {held + size} bytes, at most {_MOST_WAITING} is the limit"
                    )
                    self._note(offset, ValueError(overlap))
                    continue
                held += size
                for message in wanted:
                    heapq.heappush(waiting, message)

    def _read_summary(self, stream: BinaryIO) -> bool:
        """Read the summary section; return False if the file has no valid one."""
        try:
            section = _sound_summary(stream)
            if section is None:
                return False
            records = list(StreamReader(BytesIO(section), skip_magic=True, emit_chunks=True).records)
        except _BROKEN as error:
            if _refused(error):
                self.unread.append(f"{self.path}: its index cannot be read ({type(error).__name__}: {error})")
            return False
        statistics = next((record for record in records if isinstance(record, Statistics)), None)
        channels = {record.id: record for record in records if isinstance(record, Channel)}
        chunks = [record for record in records if isinstance(record, ChunkIndex)]
        if statistics is None or not channels:
            return False
        if sum(statistics.channel_message_counts.values()) and not chunks:
            return False  # written without chunks: there is nothing to seek by
        self.schemas, self.channels = {r.id: r for r in records if isinstance(r, Schema)}, channels
        self.counts = dict(statistics.channel_message_counts)
        if statistics.message_count:
            self.start_ns = min(statistics.message_start_time, LATEST_NS)
            self.end_ns = min(statistics.message_end_time, LATEST_NS)
        self._entries = [_Entry(c.message_start_time, c.chunk_start_offset, c.message_end_time, True) for c in chunks]
        return True

    def _scan(self, stream: BinaryIO) -> None:
        """Scan the file up to its footer or to the first unreadable record."""
        size = stream.seek(0, 2)
        offset = len(MAGIC)
        while True:
            stream.seek(offset)
            head = stream.read(_RECORD_HEAD.size)
            if len(head) < _RECORD_HEAD.size:
                self.damage.append(
                    f"{self.path} ends at byte {size} without a footer (was its recorder killed?); all records "
                    f"before byte {offset} are used"
                )
                return
            opcode, length = _RECORD_HEAD.unpack(head)
            if offset + _RECORD_HEAD.size + length > size:
                self.damage.append(
                    f"{self.path} is truncated: the record at byte {offset} should have {length} bytes, the file "
                    f"ends at byte {size} (was its recorder killed?); all records before it are used"
                )
                return
            if opcode == Opcode.FOOTER and offset + _TAIL.size == size:
                return
            if opcode == Opcode.FOOTER or opcode not in _OPCODES:
                self._note(offset, ValueError(f"unexpected opcode {opcode}"))
            try:
                self._take(stream, offset, opcode, length)
            except _BROKEN as error:
                self._note(offset, error)
            offset += _RECORD_HEAD.size + length

    def _take(self, stream: BinaryIO, offset: int, opcode: int, length: int) -> None:
        if opcode == Opcode.CHUNK:
            records = _records(_read_chunk(stream, offset))
            for record in records:
                if isinstance(record, Schema):
                    self.schemas[record.id] = record
                elif isinstance(record, Channel):
                    self.channels[record.id] = record
            messages = [record for record in records if isinstance(record, Message)]
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
            body = ReadDataStream(BytesIO(stream.read(length)))
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(body)
                self.schemas[schema.id] = schema
                return
            if opcode == Opcode.CHANNEL:
                channel = Channel.read(body)
                self.channels[channel.id] = channel
                return
            messages = [Message.read(body, length)]
        else:
            return
        known = [m for m in messages if m.channel_id in self.channels]
        if len(known) < len(messages):
            self.damage.append(f"{self.path}: at byte {offset}, {len(messages) - len(known)} messages have no channel")
        known = self._of_our_time(known, offset)
        if not known:
            return
        for message in known:
            self.counts[message.channel_id] = self.counts.get(message.channel_id, 0) + 1
        start, end = min(m.log_time for m in known), max(m.log_time for m in known)
        self._entries.append(_Entry(start, offset, end, opcode == Opcode.CHUNK))
        self.start_ns = start if self.start_ns is None else min(start, self.start_ns)
        self.end_ns = end if self.end_ns is None else max(end, self.end_ns)

    def _load(self, stream: BinaryIO, entry: _Entry) -> list[Message]:
        """Return the messages of a chunk (or the one message) at an entry; none, with a note, if it is corrupt."""
        try:
            if entry.is_chunk:
                records = _records(_read_chunk(stream, entry.offset))
                known = [r for r in records if isinstance(r, Message) and r.channel_id in self.channels]
                return self._of_our_time(known, entry.offset)
            stream.seek(entry.offset)
            _, length = _RECORD_HEAD.unpack(stream.read(_RECORD_HEAD.size))
            return self._of_our_time([Message.read(ReadDataStream(BytesIO(stream.read(length))), length)], entry.offset)
        except _BROKEN as error:
            self._note(entry.offset, error)
            return []

    def _of_our_time(self, messages: list[Message], offset: int) -> list[Message]:
        """Return messages with valid times; note the others."""
        kept = [message for message in messages if max(message.log_time, message.publish_time) <= LATEST_NS]
        if len(kept) < len(messages):
            latest = max(max(message.log_time, message.publish_time) for message in messages)
            self._damaged(
                f"{self.path}: at byte {offset}, {len(messages) - len(kept)} messages have times up to {latest} "
                f"ns, later than {LATEST_NS} ns, and are ignored"
            )
        return kept

    def _note(self, offset: int, error: BaseException) -> None:
        note = f"{self.path}: the record at byte {offset} is corrupt and ignored ({type(error).__name__}: {error})"
        if self._damaged(note) and _refused(error):
            self.unread.append(note)

    def _damaged(self, note: str) -> bool:
        """Note damage; return whether it is new, because parts may be read repeatedly."""
        if note in self.damage:
            return False
        self.damage.append(note)
        return True


def _refused(error: BaseException) -> bool:
    """Return whether the system failed to read; a position before the file's start is an error of the bytes."""
    return isinstance(error, OSError) and error.errno not in (None, errno.EINVAL)


def _sound_summary(stream: BinaryIO) -> bytes | None:
    """Return the summary section and the footer, if the file has them and the checksum, if any, is correct."""
    size = stream.seek(0, 2)
    stream.seek(size - _TAIL.size)
    opcode, length, summary_start, _, checksum, magic = _TAIL.unpack(stream.read(_TAIL.size))
    if (opcode, length, magic) != (Opcode.FOOTER, 20, MAGIC) or not len(MAGIC) <= summary_start < size:
        return None
    if size - summary_start > _LARGEST_SUMMARY:
        return None
    stream.seek(summary_start)
    section = stream.read(size - summary_start)
    covered = memoryview(section)[: -len(MAGIC) - 4]
    return section if checksum in (0, zlib.crc32(covered)) else None


def _read_chunk(stream: BinaryIO, offset: int) -> Chunk:
    size = stream.seek(0, 2)
    stream.seek(offset)
    opcode, length = _RECORD_HEAD.unpack(stream.read(_RECORD_HEAD.size))
    if opcode != Opcode.CHUNK or offset + length > size:
        raise ValueError(f"expected a chunk within {size} bytes, found opcode {opcode} of {length} bytes")
    if length > _LARGEST_CHUNK:
        raise ValueError(f"chunk has {length} bytes, more than {_LARGEST_CHUNK}")
    return Chunk.read(ReadDataStream(BytesIO(stream.read(length))))


def _records(chunk: Chunk) -> list[McapRecord]:
    """Yield a chunk's records. Raises what `_BROKEN` names, before more than `_LARGEST_CHUNK` bytes and one record per
    compressed byte: a hundred kilobytes may expand to gigabytes, or to millions of empty records.
    """
    whole = _decompressed(chunk)
    most, count, at = len(chunk.data) + _RECORDS_BESIDE, 0, 0
    while at < len(whole):
        opcode, length = _RECORD_HEAD.unpack_from(whole, at)
        count += 1
        if opcode not in _CHUNK_OPCODES or count > most:
            raise ValueError(f"record {count} of the chunk has opcode {opcode}; at most {most} records are read")
        at += _RECORD_HEAD.size + length
    plain = replace(chunk, compression="", data=whole, uncompressed_size=len(whole))
    return list(breakup_chunk(plain, validate_crc=True))


def _decompressed(chunk: Chunk) -> bytes:
    """Return a chunk's records as bytes. mcap's own function allocates what a zstd frame states, and has no limit for
    lz4.
    """
    stated = chunk.uncompressed_size
    if chunk.compression == "zstd":
        stated = max(stated, zstandard.frame_content_size(chunk.data))
    if stated > _LARGEST_CHUNK:
        raise ValueError(f"chunk states a size of {stated} bytes, more than {_LARGEST_CHUNK}")
    match chunk.compression:
        case "":
            return bytes(chunk.data)
        case "zstd":
            return bytes(zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=stated))
        case "lz4":
            return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=stated))
    raise ValueError(f"unknown compression {chunk.compression!r}; zstd, lz4 and none are supported")


def _not_mcap(path: Path, magic: bytes) -> str:
    if not magic:
        return f"{path} is empty, not an MCAP file"
    if magic.startswith(b"SQLite"):
        return (
            f"{path} is a sqlite3 bag, only MCAP is supported: convert it with `ros2 bag convert` or `rosbags-convert`"
        )
    if magic.startswith(b"#ROSBAG"):
        return f"{path} is a ROS 1 bag, only MCAP is supported: convert it with `rosbags-convert`"
    return f"{path} is not an MCAP file: it begins with {magic.hex(' ')}, expected {MAGIC.hex(' ')}"
