"""Index of the messages in one MCAP file, from its summary, or by reading through a file that has none.

A recorder that is killed leaves a file without a summary, cut inside a record. Everything before the cut is whole, so
it is read; where reading stopped, and why, is kept in words with the byte offset.
"""

from __future__ import annotations

import heapq
import struct
import zlib
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Channel, Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk
from zstandard import ZstdError

from ltm_core.errors import RecordingError

MAGIC = b"\x89MCAP0\r\n"
_OPCODES = {*range(1, 16), *range(128, 256)}  # those of the specification, and those left to its users
_RECORD_HEAD = struct.Struct("<BQ")
_TAIL = struct.Struct("<BQQQI8s")  # the footer record and the closing magic
_LARGEST_CHUNK = 4 << 30

# What the mcap library and what it uses raise when bytes are not what they should be.
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
    """The channels of an MCAP file and the places of its messages.

    `damage`: what could not be read, with byte offsets; empty for a whole file. `counts`: messages a channel id.
    """

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    start_ns: int | None = None
    end_ns: int | None = None
    damage: list[str] = field(default_factory=list)
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
        """Messages of the given channels with start_ns <= log_time < end_ns, by log time, then by place in the file.

        Chunks that turn out to be broken are left out and noted in `damage`.
        """
        # A chunk waits in the heap under its first message's time, and its messages join it when it is opened, so at
        # most the chunks that overlap in time are in memory.
        waiting: list[tuple[int, int, int, _Entry | Message]] = [
            (entry.start_ns, entry.offset, -1, entry)
            for entry in self._entries
            if (start_ns is None or entry.end_ns >= start_ns) and (end_ns is None or entry.start_ns < end_ns)
        ]
        heapq.heapify(waiting)
        with self.path.open("rb") as stream:
            while waiting:
                _, offset, _, item = heapq.heappop(waiting)
                if isinstance(item, Message):
                    yield self.channels[item.channel_id], item
                    continue
                for place, message in enumerate(self._load(stream, item)):
                    if message.channel_id not in channel_ids:
                        continue
                    if start_ns is not None and message.log_time < start_ns:
                        continue
                    if end_ns is None or message.log_time < end_ns:
                        heapq.heappush(waiting, (message.log_time, offset, place, message))

    def _read_summary(self, stream: BinaryIO) -> bool:
        """Fill in from the summary section; False where the file has none that serves."""
        try:
            if not _summary_is_sound(stream):
                return False
            stream.seek(0)
            summary = SeekingReader(stream).get_summary()
        except _BROKEN:
            return False
        if summary is None or summary.statistics is None or not summary.channels:
            return False
        if sum(summary.statistics.channel_message_counts.values()) and not summary.chunk_indexes:
            return False  # written without chunks: there is nothing to seek by
        self.schemas, self.channels = dict(summary.schemas), dict(summary.channels)
        self.counts = dict(summary.statistics.channel_message_counts)
        if summary.statistics.message_count:
            self.start_ns = summary.statistics.message_start_time
            self.end_ns = summary.statistics.message_end_time
        self._entries = [
            _Entry(c.message_start_time, c.chunk_start_offset, c.message_end_time, True) for c in summary.chunk_indexes
        ]
        return True

    def _scan(self, stream: BinaryIO) -> None:
        """Fill in by reading through the file up to its footer or to the first place that cannot be read."""
        size = stream.seek(0, 2)
        offset = len(MAGIC)
        while True:
            stream.seek(offset)
            head = stream.read(_RECORD_HEAD.size)
            if len(head) < _RECORD_HEAD.size:
                self.damage.append(
                    f"{self.path} ends at byte {size} without a footer (was its recorder killed?); "
                    f"all records before byte {offset} are read"
                )
                return
            opcode, length = _RECORD_HEAD.unpack(head)
            if offset + _RECORD_HEAD.size + length > size:
                self.damage.append(
                    f"{self.path} is cut short: the record at byte {offset} should have {length} bytes, the file "
                    f"ends at byte {size} (was its recorder killed?); all records before it are read"
                )
                return
            if opcode == Opcode.FOOTER and offset + _TAIL.size == size:
                return
            if opcode == Opcode.FOOTER or opcode not in _OPCODES:
                self._note(offset, ValueError(f"opcode {opcode} does not belong there"))
            try:
                self._take(stream, offset, opcode, length)
            except _BROKEN as error:
                self._note(offset, error)
            offset += _RECORD_HEAD.size + length

    def _take(self, stream: BinaryIO, offset: int, opcode: int, length: int) -> None:
        if opcode == Opcode.CHUNK:
            records = breakup_chunk(_read_chunk(stream, offset), validate_crc=True)
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
        if not known:
            return
        for message in known:
            self.counts[message.channel_id] = self.counts.get(message.channel_id, 0) + 1
        start, end = min(m.log_time for m in known), max(m.log_time for m in known)
        self._entries.append(_Entry(start, offset, end, opcode == Opcode.CHUNK))
        self.start_ns = start if self.start_ns is None else min(start, self.start_ns)
        self.end_ns = end if self.end_ns is None else max(end, self.end_ns)

    def _load(self, stream: BinaryIO, entry: _Entry) -> list[Message]:
        """The messages of a chunk (or the one message) at an entry; none, and a note, where it is broken."""
        try:
            if entry.is_chunk:
                records = breakup_chunk(_read_chunk(stream, entry.offset), validate_crc=True)
                return [r for r in records if isinstance(r, Message) and r.channel_id in self.channels]
            stream.seek(entry.offset)
            _, length = _RECORD_HEAD.unpack(stream.read(_RECORD_HEAD.size))
            return [Message.read(ReadDataStream(BytesIO(stream.read(length))), length)]
        except _BROKEN as error:
            self._note(entry.offset, error)
            return []

    def _note(self, offset: int, error: BaseException) -> None:
        note = f"{self.path}: the record at byte {offset} is broken and left out ({type(error).__name__}: {error})"
        if note not in self.damage:
            self.damage.append(note)


def _summary_is_sound(stream: BinaryIO) -> bool:
    """Whether the file ends in a footer whose checksum of the summary section, if it has one, is right."""
    size = stream.seek(0, 2)
    stream.seek(size - _TAIL.size)
    opcode, length, summary_start, _, checksum, magic = _TAIL.unpack(stream.read(_TAIL.size))
    if (opcode, length, magic) != (Opcode.FOOTER, 20, MAGIC) or not len(MAGIC) <= summary_start < size:
        return False
    stream.seek(summary_start)
    covered = stream.read(size - len(MAGIC) - 4 - summary_start)
    return checksum in (0, zlib.crc32(covered))


def _read_chunk(stream: BinaryIO, offset: int) -> Chunk:
    stream.seek(offset)
    opcode, length = _RECORD_HEAD.unpack(stream.read(_RECORD_HEAD.size))
    body = stream.read(length)
    if opcode != Opcode.CHUNK or len(body) < length:
        raise ValueError(f"expected a chunk of {length} bytes, found opcode {opcode} with {len(body)}")
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    if chunk.uncompressed_size > _LARGEST_CHUNK:
        raise ValueError(f"chunk says that it has {chunk.uncompressed_size} bytes, more than {_LARGEST_CHUNK}")
    return chunk


def _not_mcap(path: Path, magic: bytes) -> str:
    if not magic:
        return f"{path} is empty: it is no MCAP file"
    if magic.startswith(b"SQLite"):
        return f"{path} is a sqlite3 bag, only MCAP is read: convert it with `ros2 bag convert` or `rosbags-convert`"
    if magic.startswith(b"#ROSBAG"):
        return f"{path} is a ROS 1 bag, only MCAP is read: convert it with `rosbags-convert`"
    return f"{path} is no MCAP file: it begins with {magic.hex(' ')}, expected {MAGIC.hex(' ')}"
