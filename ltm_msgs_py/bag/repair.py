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
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Statistics,
    SummaryOffset,
)

from ltm_core.base.errors import ConfigError, RecordingError
from ltm_core.storage.config_io import parse_yaml
from ltm_msgs_py.bag.mcap_chunk import BROKEN, RECORD_HEAD, read_chunk, records_of
from ltm_msgs_py.bag.mcap_index import MAGIC, McapIndex
from ltm_msgs_py.bag.metadata import FileRecord, TopicRecord, bag_information, qos_profile, write_metadata

_log = logging.getLogger(__name__)


def finish_cut_file(path: Path) -> None:
    """Complete a file that BagWriter could not finish, so that every MCAP reader accepts it.

    Raises RecordingError if it is not an MCAP file, OSError if the disk fails; the complete chunks always stay."""
    index = McapIndex.open(path)
    with path.open("r+b") as file:
        end = _with_header(file)
        chunks, counts = [], Counter[int]()
        for offset in index.chunk_offsets:
            chunk, messages = _indexed(file, offset)
            if messages.keys() <= chunk.message_index_offsets.keys():  # else its end was not written
                chunks.append(chunk)
                counts.update(messages)
                end = offset + chunk.chunk_length + chunk.message_index_length
        file.truncate(end)
        file.seek(end)
        file.write(_tail(index, chunks, counts, end))
        file.flush()
        os.fsync(file.fileno())


def _with_header(file: BinaryIO) -> int:
    """Return the end of the header, written now if it is incomplete: then the file holds nothing else."""
    size = file.seek(0, os.SEEK_END)
    file.seek(len(MAGIC))
    head = file.read(RECORD_HEAD.size)
    opcode, length = RECORD_HEAD.unpack(head) if len(head) == RECORD_HEAD.size else (0, 0)
    end: int = len(MAGIC) + RECORD_HEAD.size + length
    if opcode == Opcode.HEADER and end <= size:
        return end
    file.truncate(len(MAGIC))
    file.seek(len(MAGIC))
    return len(MAGIC) + file.write(_built([Header(library="ltm", profile="ros2")]))


def _indexed(file: BinaryIO, offset: int) -> tuple[ChunkIndex, Counter[int]]:
    """Return the index of a chunk, with its complete message indexes, and the number of its messages by channel."""
    chunk = read_chunk(file, offset)
    begin = end = file.tell()
    indexes: dict[int, int] = {}
    while len(head := file.read(RECORD_HEAD.size)) == RECORD_HEAD.size:
        opcode, length = RECORD_HEAD.unpack(head)
        body = file.read(length) if opcode == Opcode.MESSAGE_INDEX else b""
        if opcode != Opcode.MESSAGE_INDEX or len(body) < length:
            break
        indexes[MessageIndex.read(ReadDataStream(BytesIO(body))).channel_id] = end
        end += RECORD_HEAD.size + length
    found = ChunkIndex(
        chunk_length=begin - offset,
        chunk_start_offset=offset,
        compression=chunk.compression,
        compressed_size=len(chunk.data),
        message_end_time=chunk.message_end_time,
        message_index_length=end - begin,
        message_index_offsets=indexes,
        message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )
    return found, Counter(record.channel_id for record in records_of(chunk) if isinstance(record, Message))


def _tail(index: McapIndex, chunks: Sequence[ChunkIndex], counts: Counter[int], end: int) -> bytes:
    """Return the end of the data at byte `end`, summary, footer and magic."""
    data_end = _built([DataEnd(0)])
    start = end + len(data_end)
    statistics = Statistics(
        attachment_count=0,
        channel_count=len(index.channels),
        channel_message_counts=dict(counts),
        chunk_count=len(chunks),
        message_count=counts.total(),
        message_end_time=max((c.message_end_time for c in chunks), default=0),
        message_start_time=min((c.message_start_time for c in chunks), default=0),
        metadata_count=0,
        schema_count=len(index.schemas),
    )
    groups: dict[int, list[McapRecord]] = {
        Opcode.SCHEMA: [*index.schemas.values()],
        Opcode.CHANNEL: [*index.channels.values()],
        Opcode.STATISTICS: [statistics],
        Opcode.CHUNK_INDEX: [*chunks],
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
    """Repair the truncated files of a bag, among `files`, remove empty ones, and write its metadata.yaml.

    Raises RecordingError if a file is not an MCAP file, is too damaged, or the disk fails."""
    try:
        for file in (empty := [file for file in files if not file.stat().st_size]):
            file.unlink()
        files = [file for file in files if file not in empty]
        for file in files:
            if damage := McapIndex.open(file).damage:
                _log.warning("repairing: %s", "; ".join(damage))
                finish_cut_file(file)
        rewrite_metadata(folder, files)
    except BROKEN as error:
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
