"""Repair bags whose recorder was killed, and truncated MCAP files.

Everything after the last complete chunk of a file is removed, and the index is written again, without corrupt chunks.

Source: MCAP specification, https://mcap.dev/spec."""

from __future__ import annotations

import logging
import os
import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Message,
    MessageIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from ltm_core.base.errors import ConfigError, RecordingError
from ltm_core.storage.config_io import parse_yaml
from ltm_msgs_py.bag.mcap_chunk import BROKEN, RECORD_HEAD, records_of
from ltm_msgs_py.bag.mcap_index import MAGIC, McapIndex
from ltm_msgs_py.bag.metadata import FileRecord, TopicRecord, bag_information, qos_profile, write_metadata

_log = logging.getLogger(__name__)


@dataclass
class _Content:
    """Content of a file's complete chunks; `end`: end of the last one with its message indexes."""

    end: int = 0
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    counts: Counter[int] = field(default_factory=Counter)


def finish_cut_file(path: Path) -> None:
    """Complete a file that BagWriter could not finish, so that every MCAP reader accepts it.

    Raises RecordingError if it is not an MCAP file, OSError if the disk fails; the complete chunks always stay."""
    with path.open("r+b") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        if file.read(len(MAGIC)) != MAGIC:
            raise RecordingError(f"{path} is not an MCAP file; it was not changed")
        content = _scan(file, size)
        file.truncate(content.end)
        file.seek(content.end)
        file.write(_tail(content))
        file.flush()
        os.fsync(file.fileno())


def _scan(file: BinaryIO, size: int) -> _Content:
    content = _Content()
    offset = len(MAGIC)
    chunk: tuple[int, Chunk, list[McapRecord]] | None = None
    indexes: dict[int, int] = {}
    index_start = 0
    while (record := _read(file, offset, size)) is not None:
        opcode, body = record
        after = offset + RECORD_HEAD.size + len(body)
        if opcode == Opcode.HEADER:
            content.end = after
        elif opcode == Opcode.CHUNK:
            try:
                whole = Chunk.read(ReadDataStream(BytesIO(body)))
                chunk, indexes, index_start = (offset, whole, records_of(whole)), {}, after
            except BROKEN:  # complete chunks may follow a corrupt one
                chunk = None
        elif opcode == Opcode.MESSAGE_INDEX:
            with suppress(*BROKEN):
                indexes[MessageIndex.read(ReadDataStream(BytesIO(body))).channel_id] = offset
        else:
            break  # the tail of a file whose end was not written
        offset = after
        if chunk is not None and _complete(chunk[2], indexes):
            _take(content, chunk, indexes, index_start, after)
            chunk = None
    return content


def _read(file: BinaryIO, offset: int, size: int) -> tuple[int, bytes] | None:
    """Return the record at an offset; None if it is incomplete."""
    file.seek(offset)
    head = file.read(RECORD_HEAD.size)
    if len(head) < RECORD_HEAD.size:
        return None
    opcode, length = RECORD_HEAD.unpack(head)
    if offset + RECORD_HEAD.size + length > size:
        return None
    return opcode, file.read(length)


def _complete(records: Iterable[McapRecord], indexes: dict[int, int]) -> bool:
    """Return whether every channel of a chunk has its message index."""
    return {record.channel_id for record in records if isinstance(record, Message)} <= indexes.keys()


def _take(
    content: _Content,
    found: tuple[int, Chunk, list[McapRecord]],
    indexes: dict[int, int],
    index_start: int,
    end: int,
) -> None:
    start, chunk, records = found
    for record in records:
        if isinstance(record, Schema):
            content.schemas[record.id] = record
        elif isinstance(record, Channel):
            content.channels[record.id] = record
        elif isinstance(record, Message):
            content.counts[record.channel_id] += 1
    content.chunks.append(
        ChunkIndex(
            chunk_length=index_start - start,
            chunk_start_offset=start,
            compression=chunk.compression,
            compressed_size=len(chunk.data),
            message_end_time=chunk.message_end_time,
            message_index_length=end - index_start,
            message_index_offsets=indexes,
            message_start_time=chunk.message_start_time,
            uncompressed_size=chunk.uncompressed_size,
        )
    )
    content.end = end


def _tail(content: _Content) -> bytes:
    """Return the end of the data, summary, footer and magic."""
    data_end = _built([DataEnd(0)])
    start = content.end + len(data_end)
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(content.channels),
        channel_message_counts=dict(content.counts),
        chunk_count=len(content.chunks),
        message_count=content.counts.total(),
        message_end_time=max((c.message_end_time for c in content.chunks), default=0),
        message_start_time=min((c.message_start_time for c in content.chunks), default=0),
        metadata_count=0,
        schema_count=len(content.schemas),
    )
    groups: dict[int, list[McapRecord]] = {
        Opcode.SCHEMA: [*content.schemas.values()],
        Opcode.CHANNEL: [*content.channels.values()],
        Opcode.STATISTICS: [statistics],
        Opcode.CHUNK_INDEX: [*content.chunks],
    }
    summary, offsets = b"", []
    for opcode, records in groups.items():
        part = _built(records)
        offsets.append(SummaryOffset(opcode, start + len(summary), len(part)))
        summary += part
    offset_start = start + len(summary)
    summary += _built(offsets)
    head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, offset_start)
    footer = Footer(start, offset_start, zlib.crc32(head, zlib.crc32(summary)))
    return data_end + summary + _built([footer]) + MAGIC


def _built(records: Iterable[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def repair_bag(folder: Path, files: Sequence[Path]) -> None:
    """Repair the truncated files of a bag, among `files`, and write its metadata.yaml.

    Raises RecordingError if a file is not an MCAP file or the disk fails."""
    try:
        for file in files:
            if damage := McapIndex.open(file).damage:
                _log.warning("repairing: %s", "; ".join(damage))
                finish_cut_file(file)
        rewrite_metadata(folder, files)
    except OSError as error:
        raise RecordingError(f"cannot repair the bag {folder}: {error}") from error


def rewrite_metadata(folder: Path, files: Sequence[Path]) -> None:
    """Write metadata.yaml of a bag from its files. Raises RecordingError, OSError."""
    topics: dict[str, TopicRecord] = {}
    records = []
    for path in files:
        index = McapIndex.open(path)
        counts: Counter[str] = Counter()
        for number, channel in sorted(index.channels.items()):
            schema = index.schemas.get(channel.schema_id)
            qos = _qos(channel.metadata.get("offered_qos_profiles", ""))
            type_name = schema.name if schema is not None else ""
            type_hash = channel.metadata.get("topic_type_hash", "")
            topics.setdefault(channel.topic, TopicRecord(channel.topic, type_name, type_hash, qos))
            counts[channel.topic] += index.counts.get(number, 0)
        records.append(FileRecord(path.name, index.start_ns or 0, index.end_ns or 0, +counts))
    write_metadata(folder, bag_information(records, list(topics.values()), {}))


def _qos(text: str) -> list[dict[str, object]]:
    try:
        profiles = parse_yaml(text, "offered_qos_profiles")
    except ConfigError:
        profiles = None
    return profiles if isinstance(profiles, list) else qos_profile(latched=False, depth=10)
