"""Repair bags whose recorder was killed, and truncated MCAP files.

Everything after the last complete chunk of a file is removed, and the index is written again, without corrupt chunks.

Source: MCAP specification, https://mcap.dev/spec."""

import logging
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.records import DataEnd, Footer, Header, McapRecord, Statistics

from ltm_core.base.errors import ConfigError, RecordingError
from ltm_core.storage.config_io import parse_yaml
from ltm_core.storage.disk_io import sync
from ltm_msgs_py.bag.mcap_index import BROKEN, MAGIC, McapIndex
from ltm_msgs_py.bag.metadata import FileRecord, TopicRecord, bag_information, qos_profile, write_metadata

_log = logging.getLogger(__name__)


def finish_cut_file(path: Path) -> None:
    """Complete a file that BagWriter could not finish, so that every MCAP reader accepts it; leave a complete one.

    Raises RecordingError if it is not an MCAP file or cannot be read now, OSError if the disk fails; the complete
    chunks always stay."""
    index = McapIndex.open(path)
    if index.unread:
        raise RecordingError(f"{path} cannot be read now: {'; '.join(index.unread)}")
    if not index.damage:
        return
    _log.warning("repairing: %s", "; ".join(index.damage))
    # The index of the messages in the last chunk may be cut.
    kept = [(c, counts) for c, counts in index.chunks if counts.keys() <= c.message_index_offsets.keys()]
    chunks, counts = [chunk for chunk, _ in kept], sum((count for _, count in kept), Counter[int]())
    end = max((c.chunk_start_offset + c.chunk_length + c.message_index_length for c in chunks), default=0)
    end = max(end, index.header_end, len(MAGIC))
    header = _built([] if index.header_end else [Header(library="ltm", profile="ros2")])
    data_end = _built([DataEnd(0)])
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
    summary = _built([*index.schemas.values(), *index.channels.values(), statistics, *chunks])
    footer = _built([Footer(end + len(header) + len(data_end), 0, 0)])
    with path.open("r+b") as file:
        file.truncate(end)
        file.seek(end)
        file.write(header + data_end + summary + footer + MAGIC)
    sync(path)


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
            qos = qos_profile(latched=False, depth=10)
            with suppress(ConfigError):
                stated = parse_yaml(channel.metadata.get("offered_qos_profiles", ""), "offered_qos_profiles")
                qos = stated if isinstance(stated, list) else qos
            type_hash = channel.metadata.get("topic_type_hash", "")
            topics.setdefault(channel.topic, TopicRecord(channel.topic, index.type_of(channel), type_hash, qos))
            counts[channel.topic] += index.counts.get(number, 0)
        records.append(FileRecord(path.name, index.start_ns or 0, index.end_ns or 0, +counts))
    write_metadata(folder, bag_information(records, list(topics.values()), {}))
