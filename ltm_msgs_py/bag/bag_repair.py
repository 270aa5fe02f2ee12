"""Makes a bag whole whose recorder was killed, or that lost files: every MCAP file ended, metadata.yaml anew."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from ltm_core.errors import ConfigError, RecordingError
from ltm_core.yaml_io import parse_yaml
from ltm_msgs_py.bag.mcap_index import McapIndex
from ltm_msgs_py.bag.mcap_repair import finish_cut_file
from ltm_msgs_py.bag.metadata import FileRecord, TopicRecord, bag_information, qos_profile, write_metadata


def repair_bag(folder: Path, files: Sequence[Path]) -> None:
    """End those of a bag's `files` that were cut after their last whole chunk, and write its metadata.yaml.

    Raises RecordingError where a file is no MCAP file or the disk fails.
    """
    try:
        for file in files:
            if McapIndex.open(file).damage:
                finish_cut_file(file)
        rewrite_metadata(folder, files)
    except OSError as error:
        raise RecordingError(f"cannot repair the bag {folder}: {error}") from error


def rewrite_metadata(folder: Path, files: Sequence[Path]) -> None:
    """Write metadata.yaml of a bag by what is in its files. Raises RecordingError, OSError."""
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
