"""Read and write rosbag2's metadata.yaml, version 9 (Jazzy)."""

from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from ltm_core.base.errors import ConfigError, RecordingError
from ltm_core.storage.config_io import parse_yaml, read_yaml
from ltm_core.storage.disk_io import sync

VERSION = 9
FILE_NAME = "metadata.yaml"
INFORMATION = "rosbag2_bagfile_information"

_FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass
class TopicRecord:
    """Metadata of one topic."""

    topic: str
    type_name: str
    type_hash: str
    qos: list[dict[str, Any]]


@dataclass
class FileRecord:
    """Metadata of one file: log times of its first and last message, and messages by topic."""

    name: str
    start_ns: int
    end_ns: int
    counts: Counter[str]


def qos_profile(latched: bool, depth: int) -> list[dict[str, Any]]:
    """Return the offered QoS of one publisher: reliable, keep last, transient local if latched."""
    return [
        {
            "history": "keep_last",
            "depth": depth,
            "reliability": "reliable",
            "durability": "transient_local" if latched else "volatile",
            "deadline": dict(_FOREVER),
            "lifespan": dict(_FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_FOREVER),
            "avoid_ros_namespace_conventions": False,
        }
    ]


def is_latched(offered_qos_profiles: str) -> bool:
    """Return whether a channel's `offered_qos_profiles` (YAML) has a transient local publisher.

    Versions below 9 write RMW's number for it (1), later ones its name. Other text: False."""
    profiles: Any = None
    with suppress(ConfigError):
        profiles = parse_yaml(offered_qos_profiles, "offered_qos_profiles") if offered_qos_profiles else None
    stated = profiles if isinstance(profiles, list) else []
    return any(isinstance(p, dict) and p.get("durability") in ("transient_local", 1) for p in stated)


def bag_information(
    files: Sequence[FileRecord], topics: Sequence[TopicRecord], custom_data: Mapping[str, str]
) -> dict[str, Any]:
    """Return the content of `rosbag2_bagfile_information` for a bag of these files, in their order."""
    total = sum((file.counts for file in files), Counter[str]())
    filled = [file for file in files if file.counts]
    start = min((file.start_ns for file in filled), default=0)
    end = max((file.end_ns for file in filled), default=0)
    return {
        "version": VERSION,
        "storage_identifier": "mcap",
        "duration": {"nanoseconds": end - start},
        "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": total.total(),
        "topics_with_message_count": [
            {
                "topic_metadata": {
                    "name": topic.topic,
                    "type": topic.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": topic.qos,
                    "type_description_hash": topic.type_hash,
                },
                "message_count": total[topic.topic],
            }
            for topic in topics
        ],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name for file in files],
        "files": [
            {
                "path": file.name,
                "starting_time": {"nanoseconds_since_epoch": file.start_ns},
                "duration": {"nanoseconds": file.end_ns - file.start_ns},
                "message_count": file.counts.total(),
            }
            for file in files
        ],
        "custom_data": dict(custom_data) or None,
        "ros_distro": "jazzy",
    }


def write_metadata(folder: Path, information: Mapping[str, Any]) -> None:
    """Write a bag's metadata.yaml atomically, also in a power cut, because it marks a finished bag. Raises OSError."""
    unfinished = folder / f"{FILE_NAME}.tmp"
    unfinished.write_text(to_yaml({INFORMATION: dict(information)}), encoding="utf-8")
    sync(unfinished)
    unfinished.replace(folder / FILE_NAME)


def to_yaml(data: Any) -> str:
    """Return block-style YAML without anchors, for yaml-cpp and people."""

    class Dumper(yaml.SafeDumper):
        def ignore_aliases(self, data: Any) -> bool:
            return True

    return yaml.dump(data, Dumper=Dumper, sort_keys=False, default_flow_style=False)


def bag_files(folder: Path) -> list[Path] | None:
    """Return the files that a bag folder's metadata.yaml lists, in their order; None if it has no metadata.yaml.

    Raises RecordingError for metadata that is not rosbag2's, or files that are missing or outside the folder."""
    path = folder / FILE_NAME
    if not path.exists():
        return None
    try:
        document = read_yaml(path)
    except ConfigError as error:
        raise RecordingError(f"cannot read the bag's metadata: {error}") from error
    info = document.get(INFORMATION) if isinstance(document, dict) else None
    names = info.get("relative_file_paths") if isinstance(info, dict) else None
    if not isinstance(info, dict) or not isinstance(names, list) or not all(isinstance(n, str) for n in names):
        raise RecordingError(f"{path} is not rosbag2 metadata: it has no {INFORMATION}.relative_file_paths")
    files = []
    for name in names:
        file = folder / Path(name).name
        # A name of more than 255 bytes is an OSError to whoever asks for its file.
        known = len(name.encode()) <= 255 and file.is_file()
        if not known or Path(name).is_absolute() or ".." in Path(name).parts:
            raise RecordingError(f"{path} lists the file {name!r:.200}, which does not exist in {folder}")
        files.append(file)
    return files
