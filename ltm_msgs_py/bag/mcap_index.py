"""Index the messages in one MCAP file, from its summary, or by a scan if it has none.

A killed recorder leaves a file without a summary, truncated inside a record. Everything before that is read; the
position and the reason are reported."""

from __future__ import annotations

import errno
import heapq
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Message, MessageIndex, Schema, Statistics
from mcap.stream_reader import StreamReader

from ltm_core.base.errors import RecordingError
from ltm_msgs_py.bag.mcap_chunk import BROKEN, RECORD_HEAD, read_chunk, records_of
from ltm_msgs_py.stamp import time_text

MAGIC = b"\x89MCAP0\r\n"
LATEST_NS = 2**63 - 1
"""Latest time in ns that ROS supports; MCAP's own times go twice as far."""
_OPCODES = {*range(1, 16), *range(128, 256)}  # those of the specification, and those left to its users
_TAIL = struct.Struct("<BQQQI8s")  # the footer record and the closing magic
_LARGEST_SUMMARY = 256 << 20
_MOST_WAITING = 256 << 20
"""Maximum bytes of messages in chunks that overlap in time."""

_CONTENT = {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK}
_MOST_INDEXED = 1 << 20
"""Maximum bytes of the message index of one channel in a chunk."""


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
    _entries: list[_Entry] = field(default_factory=list)

    @classmethod
    def open(cls, path: Path) -> McapIndex:
        """Read a file's index. Raises RecordingError when the file cannot be opened or is no MCAP."""
        index = cls(path)
        with index._opened() as stream:
            try:
                magic = stream.read(len(MAGIC))
                if magic != MAGIC:
                    raise RecordingError(_not_mcap(path, magic))
                if not index._read_summary(stream):
                    index._scan(stream)
            except OSError as error:
                raise RecordingError(f"cannot read {path}: {error}") from error
        return index

    @property
    def chunk_offsets(self) -> list[int]:
        """Return the positions of the readable chunks, in the order of the file."""
        return sorted(entry.offset for entry in self._entries if entry.is_chunk)

    def messages(
        self, channel_ids: Collection[int], start_ns: int | None, end_ns: int | None
    ) -> Iterator[tuple[Channel, Message]]:
        """Yield messages of the given channels with start_ns <= log_time < end_ns, by log time, then by position in the
        file.

        Corrupt chunks are skipped and noted in `damage`. Raises RecordingError if the file cannot be opened any more.
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
        with self._opened() as stream:
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
                    self._note(stream, offset, ValueError(overlap))
                    continue
                held += size
                for message in wanted:
                    heapq.heappush(waiting, message)

    def _opened(self) -> BinaryIO:
        try:
            return self.path.open("rb")
        except OSError as error:
            raise RecordingError(f"cannot read {self.path}: {error}") from error

    def _read_summary(self, stream: BinaryIO) -> bool:
        """Read the summary section; return False if the file has no valid one."""
        try:
            section = _sound_summary(stream)
            if section is None:
                return False
            records = list(StreamReader(BytesIO(section), skip_magic=True, emit_chunks=True).records)
        except BROKEN as error:
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
            head = stream.read(RECORD_HEAD.size)
            if len(head) < RECORD_HEAD.size:
                self.damage.append(
                    f"{self.path} ends at byte {size} without a footer (was its recorder killed?); all records "
                    f"before byte {offset} are used"
                )
                return
            opcode, length = RECORD_HEAD.unpack(head)
            if offset + RECORD_HEAD.size + length > size:
                lost, what = self._held(stream, offset) if opcode in _CONTENT else (Counter[str](), "")
                self._damaged(
                    f"{self.path} is truncated: the record at byte {offset} should have {length} bytes, the file "
                    f"ends at byte {size} (was its recorder killed?){what}; all records before it are used",
                    lost,
                )
                return
            if opcode == Opcode.FOOTER and offset + _TAIL.size == size:
                return
            if opcode == Opcode.FOOTER or opcode not in _OPCODES:
                self._note(stream, offset, ValueError(f"unexpected opcode {opcode}"))
            try:
                self._take(stream, offset, opcode, length)
            except BROKEN as error:
                self._note(stream, offset, error)
            offset += RECORD_HEAD.size + length

    def _take(self, stream: BinaryIO, offset: int, opcode: int, length: int) -> None:
        if opcode == Opcode.CHUNK:
            records = records_of(read_chunk(stream, offset))
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
        known = self._valid(messages, offset)
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
                records = records_of(read_chunk(stream, entry.offset))
                return self._valid([record for record in records if isinstance(record, Message)], entry.offset)
            stream.seek(entry.offset)
            _, length = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
            return self._valid([Message.read(ReadDataStream(BytesIO(stream.read(length))), length)], entry.offset)
        except BROKEN as error:
            self._note(stream, entry.offset, error)
            return []

    def _valid(self, messages: list[Message], offset: int) -> list[Message]:
        """Return messages of a known channel with valid times; note the others."""
        known = [message for message in messages if message.channel_id in self.channels]
        if len(known) < len(messages):
            missing = len(messages) - len(known)
            self._damaged(f"{self.path}: at byte {offset}, {missing} messages have no channel", Counter({"": missing}))
        kept = [message for message in known if max(message.log_time, message.publish_time) <= LATEST_NS]
        if len(kept) < len(known):
            latest = max(max(message.log_time, message.publish_time) for message in known)
            late = (m.channel_id for m in known if max(m.log_time, m.publish_time) > LATEST_NS)
            self._damaged(
                f"{self.path}: at byte {offset}, {len(known) - len(kept)} messages have times up to {latest} "
                f"ns, later than {LATEST_NS} ns, and are ignored",
                self._by_topic(late),
            )
        return kept

    def _by_topic(self, channel_ids: Iterable[int]) -> Counter[str]:
        return Counter(self.channels[i].topic if i in self.channels else "" for i in channel_ids)

    def _held(self, stream: BinaryIO, offset: int) -> tuple[Counter[str], str]:
        """Return the messages by topic that a damaged record held, and its topics and times in words: by the message
        indexes after a chunk, else the times in its first bytes."""
        indexed: list[tuple[int, int]] = []
        times: tuple[int, ...] = ()
        try:
            stream.seek(offset)
            opcode, length = RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size))
            if opcode == Opcode.CHUNK:
                times = struct.unpack("<QQ", stream.read(16))
                stream.seek(offset + RECORD_HEAD.size + length)
                while (head := RECORD_HEAD.unpack(stream.read(RECORD_HEAD.size)))[0] == Opcode.MESSAGE_INDEX:
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
    if (opcode, length, magic) != (Opcode.FOOTER, 20, MAGIC) or not len(MAGIC) <= summary_start < size:
        return None
    if size - summary_start > _LARGEST_SUMMARY:
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
