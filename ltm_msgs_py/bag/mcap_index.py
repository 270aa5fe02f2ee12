"""Index the messages in one MCAP file, from its summary, or by a scan if it has none, within limits of memory.

A killed recorder leaves a file without a summary, truncated inside a record. The rest is reported."""

import errno
import heapq
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, McapRecord, Message, MessageIndex, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk

from ltm_core.base.errors import RecordingError
from ltm_msgs_py.stamp import time_text

MAGIC = b"\x89MCAP0\r\n"
LATEST_NS = 2**63 - 1
"""Latest time in ns that ROS supports; MCAP's own times go twice as far."""
LARGEST_MESSAGE = 128 << 20
"""Maximum bytes of a message or chunk: recorders write chunks of a few megabytes, or of one larger message."""
BROKEN = (
    *(McapError, zstandard.ZstdError, struct.error, ValueError, LookupError),
    *(RuntimeError, EOFError, MemoryError, OverflowError, OSError),
)
"""Exceptions of the mcap library and its dependencies for corrupt bytes."""
_HEAD = struct.Struct("<BQ")  # opcode and length of a record
_TAIL = struct.Struct("<BQQQI8s")  # the footer record and the closing magic
_IN_CHUNKS = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE}
_CONTENT = {*_IN_CHUNKS, Opcode.CHUNK}
_PRIVATE = range(128, 256)  # opcodes that the specification leaves to its users
_RECORDS_BESIDE = 1000
"""Maximum number of records of a chunk beyond one per compressed byte; recorded ones take ten bytes and more."""
_LARGEST_SUMMARY = 256 << 20
_MOST_WAITING = 256 << 20
"""Maximum bytes of messages in chunks that overlap in time."""
_MOST_INDEXED = 1 << 20
"""Maximum bytes of the message index of one channel in a chunk."""


@dataclass
class FileIndex:
    """The channels of a recording's file.

    `damage`: unreadable parts, with byte offsets, times and topics; empty for a complete file. `lost`: their messages
    by topic; under "", one for each part of unknown content. `unread`: parts that the system failed to read, maybe
    temporarily. `counts`: messages per channel id."""

    path: Path
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    start_ns: int | None = None
    end_ns: int | None = None
    damage: list[str] = field(default_factory=list)
    lost: Counter[str] = field(default_factory=Counter)
    unread: list[str] = field(default_factory=list)

    def type_of(self, channel: Channel) -> str:
        schema = self.schemas.get(channel.schema_id)
        return schema.name if schema is not None else ""


@dataclass
class McapIndex(FileIndex):
    """The channels of an MCAP file and the positions of its messages.

    `header_end`, `chunks`: of a scanned file, the end of its header (0: it has none), and each readable chunk with its
    messages per channel id."""

    header_end: int = 0
    chunks: list[tuple[ChunkIndex, Counter[int]]] = field(default_factory=list)
    _spans: list[tuple[int, int, int]] = field(default_factory=list)
    """First and last log time, and offset, of each chunk and each message outside chunks."""

    @classmethod
    def open(cls, path: Path) -> "McapIndex":
        """Read a file's index. Raises RecordingError when the file cannot be opened or is no MCAP."""
        index = cls(path)
        with index._opened() as stream:
            if (magic := stream.read(len(MAGIC))) != MAGIC:
                raise RecordingError(_not_mcap(path, magic))
            if not index._read_summary(stream):
                index._scan(stream)
        return index

    def messages(
        self, channel_ids: Collection[int], start_ns: int | None, end_ns: int | None
    ) -> Iterator[tuple[Channel, Message]]:
        """Yield messages of channels with start_ns <= log_time < end_ns, by log time, then by place in the file.

        Corrupt chunks are noted in `damage`. Raises RecordingError if the file cannot be opened any more."""
        # A chunk waits in the heap under its first message's time, and its messages join it when it is opened, so at
        # most the chunks that overlap in time are in memory.
        begin, end = start_ns or 0, 1 << 64 if end_ns is None else end_ns  # beyond MCAP's own times
        waiting: list[tuple[int, int, int, Message | None]] = [
            (first, offset, -1, None) for first, last, offset in self._spans if last >= begin and first < end
        ]
        heapq.heapify(waiting)
        held = 0
        with self._opened() as stream:
            while waiting:
                _, offset, _, message = heapq.heappop(waiting)
                if message is not None:
                    held -= len(message.data)
                    yield self.channels[message.channel_id], message
                    continue
                try:
                    found = self._valid(_records_of(_chunk_at(stream, offset)), offset)
                    wanted = [m for m in found if m.channel_id in channel_ids and begin <= m.log_time < end]
                    size = held + sum(len(m.data) for m in wanted)
                    if held and size > _MOST_WAITING:
                        raise ValueError(f"it and others of its time hold {size} bytes of at most {_MOST_WAITING}")
                except BROKEN as error:
                    self._note(stream, offset, error)
                    continue
                held = size
                for place, one in enumerate(wanted):
                    heapq.heappush(waiting, (one.log_time, offset, place, one))

    @contextmanager
    def _opened(self) -> Iterator[BinaryIO]:
        try:
            with self.path.open("rb") as stream:
                yield stream
        except OSError as error:
            raise RecordingError(f"cannot read {self.path}: {error}") from error

    def _read_summary(self, stream: BinaryIO) -> bool:
        """Read the summary section; return False if the file has no valid one."""
        try:
            section = _sound_summary(stream)
            records = list(StreamReader(BytesIO(section), skip_magic=True, emit_chunks=True).records) if section else []
        except BROKEN as error:
            if _refused(error):
                self.unread.append(f"{self.path}: its index cannot be read ({type(error).__name__}: {error})")
            return False
        statistics = next((record for record in records if isinstance(record, Statistics)), None)
        channels = {record.id: record for record in records if isinstance(record, Channel)}
        chunks = [record for record in records if isinstance(record, ChunkIndex)]
        # Messages without chunks cannot be found by the summary.
        if statistics is None or not channels or (any(statistics.channel_message_counts.values()) and not chunks):
            return False
        self.schemas, self.channels = {r.id: r for r in records if isinstance(r, Schema)}, channels
        self.counts = dict(statistics.channel_message_counts)
        if statistics.message_count:
            self.start_ns = min(statistics.message_start_time, LATEST_NS)
            self.end_ns = min(statistics.message_end_time, LATEST_NS)
        self._spans = [(c.message_start_time, c.message_end_time, c.chunk_start_offset) for c in chunks]
        return True

    def _scan(self, stream: BinaryIO) -> None:
        """Scan the file up to its footer or to the first unreadable record."""
        size, offset = stream.seek(0, 2), len(MAGIC)
        while offset + _HEAD.size <= size:
            stream.seek(offset)
            opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
            end = offset + _HEAD.size + length
            if end > size:
                lost, what = self._held(stream, offset) if opcode in _CONTENT else (Counter[str](), "")
                self._damaged(
                    f"{self.path} is truncated: the record at byte {offset} should have {length} bytes, the file "
                    f"ends at byte {size} (was its recorder killed?){what}; all records before it are used",
                    lost,
                )
                return
            if opcode == Opcode.FOOTER and offset + _TAIL.size == size:
                return
            try:
                self._take(stream, offset, opcode, end)
            except BROKEN as error:
                self._note(stream, offset, error)
            offset = end
        self.damage.append(
            f"{self.path} ends at byte {size} without a footer (was its recorder killed?); all records before byte "
            f"{offset} are used"
        )

    def _take(self, stream: BinaryIO, offset: int, opcode: int, end: int) -> None:
        """Index the record at an offset, whose head has been read."""
        if opcode == Opcode.HEADER:
            self.header_end = end
        elif opcode == Opcode.MESSAGE_INDEX and self.chunks:
            (channel,), (chunk, _) = struct.unpack("<H", stream.read(2)), self.chunks[-1]
            # One that does not follow this chunk belongs to a corrupt one.
            if offset == chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length:
                chunk.message_index_offsets[channel] = offset
                chunk.message_index_length += end - offset
        elif opcode not in (*range(1, 16), *_PRIVATE) or opcode == Opcode.FOOTER:
            raise ValueError(f"unexpected opcode {opcode}")
        if opcode not in _CONTENT:
            return
        chunk = _chunk_at(stream, offset)
        records = _records_of(chunk)
        self.schemas |= {record.id: record for record in records if isinstance(record, Schema)}
        self.channels |= {record.id: record for record in records if isinstance(record, Channel)}
        messages = self._valid(records, offset)
        counts = Counter(message.channel_id for message in messages)
        start, last = (pick((m.log_time for m in messages), default=0) for pick in (min, max))
        if opcode == Opcode.CHUNK:
            index = ChunkIndex(end - offset, offset, "", len(chunk.data), last, 0, {}, start, chunk.uncompressed_size)
            self.chunks.append((replace(index, compression=chunk.compression), counts))
        if messages:
            self.counts = dict(Counter(self.counts) + counts)
            self._spans.append((start, last, offset))
            self.start_ns = start if self.start_ns is None else min(start, self.start_ns)
            self.end_ns = last if self.end_ns is None else max(last, self.end_ns)

    def _valid(self, records: Iterable[McapRecord], offset: int) -> list[Message]:
        """Return the messages among records that have a known channel and valid times; note the others."""
        found = [record for record in records if isinstance(record, Message)]
        known = [message for message in found if message.channel_id in self.channels]
        kept = [message for message in known if max(message.log_time, message.publish_time) <= LATEST_NS]
        place = f"{self.path}: at byte {offset}"
        if missing := len(found) - len(known):
            self._damaged(f"{place}, {missing} messages have no channel", Counter({"": missing}))
        if late := [m for m in known if max(m.log_time, m.publish_time) > LATEST_NS]:
            latest = max(max(message.log_time, message.publish_time) for message in late)
            limit = f"{len(late)} messages have times up to {latest} ns, later than {LATEST_NS} ns"
            self._damaged(f"{place}, {limit}, and are ignored", self._by_topic(m.channel_id for m in late))
        return kept

    def _by_topic(self, channel_ids: Iterable[int]) -> Counter[str]:
        return Counter(self.channels[i].topic if i in self.channels else "" for i in channel_ids)

    def _held(self, stream: BinaryIO, offset: int) -> tuple[Counter[str], str]:
        """Return the messages by topic that a damaged record held, in numbers and in words, by the message indexes
        after it."""
        indexed: list[tuple[int, int]] = []
        times: tuple[int, ...] = ()
        try:
            stream.seek(offset)
            opcode, length = _HEAD.unpack(stream.read(_HEAD.size))
            if opcode == Opcode.CHUNK:
                times = struct.unpack("<QQ", stream.read(16))
                stream.seek(offset + _HEAD.size + length)
                while (head := _HEAD.unpack(stream.read(_HEAD.size)))[0] == Opcode.MESSAGE_INDEX:
                    index = MessageIndex.read(ReadDataStream(BytesIO(stream.read(min(head[1], _MOST_INDEXED)))))
                    indexed += [(time, index.channel_id) for time, _ in index.records]
        except BROKEN:
            pass  # the rest of what it held is unknown
        lost = self._by_topic(channel for _, channel in indexed) or Counter({"": 1})
        times = tuple(time for time, _ in indexed) or times
        known = max(times, default=LATEST_NS) < LATEST_NS
        span = f" from {time_text(min(times))} to {time_text(max(times))}" if known else ""
        named = ", ".join(f"{count} of {topic or 'an unknown topic'}" for topic, count in sorted(lost.items()))
        return lost, f"; lost{span}: {named if indexed else 'an unknown number of messages'}"

    def _note(self, stream: BinaryIO, offset: int, error: BaseException) -> None:
        lost, what = self._held(stream, offset)
        note = (
            f"{self.path}: the record at byte {offset} is corrupt and ignored ({type(error).__name__}: {error}){what}"
        )
        if self._damaged(note, lost) and _refused(error):
            self.unread.append(note)

    def _damaged(self, note: str, lost: Counter[str]) -> bool:
        """Note damage; return whether it is new, because parts may be read repeatedly."""
        if note in self.damage:
            return False
        self.damage.append(note)
        self.lost += lost
        return True


def _refused(error: BaseException) -> bool:
    """Return whether the system failed to read; a position before the file's start is an error of the bytes."""
    return isinstance(error, OSError) and error.errno not in (None, errno.EINVAL)


def _sound_summary(stream: BinaryIO) -> bytes | None:
    """Return the summary section and the footer, if the file has them and the checksum, if any, is correct."""
    size = stream.seek(0, 2)
    stream.seek(size - _TAIL.size)
    opcode, length, summary_start, _, checksum, magic = _TAIL.unpack(stream.read(_TAIL.size))
    known = len(MAGIC) <= summary_start < size <= summary_start + _LARGEST_SUMMARY
    if (opcode, length, magic) != (Opcode.FOOTER, 20, MAGIC) or not known:
        return None
    stream.seek(summary_start)
    section = stream.read(size - summary_start)
    covered = memoryview(section)[: -len(MAGIC) - 4]
    return section if checksum in (0, zlib.crc32(covered)) else None


def _not_mcap(path: Path, magic: bytes) -> str:
    if not magic:
        return f"{path} is empty, not an MCAP file"
    if magic.startswith(b"#ROSBAG"):
        return f"{path} is a ROS 1 bag, which is not supported; convert it with `rosbags-convert`"
    return f"{path} is not an MCAP file: it begins with {magic.hex(' ')}, expected {MAGIC.hex(' ')}"


def _chunk_at(stream: BinaryIO, offset: int) -> Chunk:
    """Return the chunk at an offset; a record outside chunks as a chunk of its own. Raises what `BROKEN` names."""
    size = stream.seek(0, 2)
    stream.seek(offset)
    head = stream.read(_HEAD.size)
    opcode, length = _HEAD.unpack(head)
    if offset + length > size or opcode not in _CONTENT:
        raise ValueError(f"expected a chunk within {size} bytes, found opcode {opcode} of {length} bytes")
    if length > LARGEST_MESSAGE:
        raise ValueError(f"chunk has {length} bytes, more than {LARGEST_MESSAGE}")
    body = stream.read(length)
    return Chunk.read(ReadDataStream(BytesIO(body))) if opcode == Opcode.CHUNK else _plain_chunk(head + body)


def _plain_chunk(data: bytes, crc: int = 0) -> Chunk:
    return Chunk("", data, message_end_time=0, message_start_time=0, uncompressed_crc=crc, uncompressed_size=len(data))


def _records_of(chunk: Chunk) -> list[McapRecord]:
    """Return a chunk's records. Raises what `BROKEN` names, before more than `LARGEST_MESSAGE` bytes and one record per
    compressed byte: a hundred kilobytes may expand to gigabytes, or to millions of empty records."""
    whole = _decompressed(chunk)
    most, count, at = len(chunk.data) + _RECORDS_BESIDE, 0, 0
    while at < len(whole):
        opcode, length = _HEAD.unpack_from(whole, at)
        count += 1
        if (opcode not in _IN_CHUNKS and opcode not in _PRIVATE) or count > most:
            raise ValueError(f"record {count} of the chunk has opcode {opcode}; at most {most} records are read")
        at += _HEAD.size + length
    return list(breakup_chunk(_plain_chunk(whole, chunk.uncompressed_crc), validate_crc=True))


def _decompressed(chunk: Chunk) -> bytes:
    """Return a chunk's records as bytes. mcap's own function has no limits."""
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
