"""Writes a bag: one MCAP file and its metadata.yaml, as rosbag2 lays them out."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from mcap.writer import CompressionType, Writer
from rclpy.serialization import serialize_message

from ltm_core.errors import RecordingError
from ltm_core.output_io import require_folder
from ltm_msgs_py.bag.metadata import FILE_NAME, TopicRecord, bag_information, qos_profile, to_yaml
from ltm_msgs_py.bag.schemas import schema_text, type_hash, type_name_of

Compression = Literal["zstd"] | None
_COMPRESSIONS = {"zstd": CompressionType.ZSTD, None: CompressionType.NONE}
_LATEST_NS = 2**63 - 1


class BagWriter:
    """Writes `<path>/<name>_0.mcap` and, when closed, `<path>/metadata.yaml`.

    A context manager; not for several threads at once. A chunk is on disk as soon as it is full (`chunk_size` bytes
    before compression) or `flush` is called, and an interrupted file can be read up to its last chunk. metadata.yaml
    appears in one step at the very end: a bag that has one is complete.
    """

    def __init__(
        self,
        path: Path | str,
        compression: Compression = "zstd",
        custom_data: Mapping[str, str] | None = None,
        chunk_size: int = 1 << 20,
    ) -> None:
        """`custom_data`: for metadata.yaml. Raises RecordingError when `path` exists and is not an empty folder."""
        if compression not in _COMPRESSIONS:
            raise RecordingError(f"bag compression must be 'zstd' or None, got {compression!r}")
        self.path = Path(path)
        self.require_free(self.path)
        self.file = self.path / f"{self.path.resolve().name}_0.mcap"
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            self._stream = self.file.open("xb")
        except OSError as error:
            raise RecordingError(f"cannot write a bag to {self.path}: {error}") from error
        self._writer = Writer(self._stream, chunk_size=chunk_size, compression=_COMPRESSIONS[compression])
        self._writer.start(profile="ros2")
        self._custom_data = dict(custom_data or {})
        self._topics: dict[str, TopicRecord] = {}
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._start_ns, self._end_ns = _LATEST_NS, 0
        self._closed = False

    @staticmethod
    def require_free(path: Path) -> None:
        """Raises RecordingError unless `path` does not exist or is an empty folder, ConfigError where nothing can be
        written."""
        if path.exists() and not (path.is_dir() and not any(path.iterdir())):
            raise RecordingError(f"cannot write a bag to {path}: it exists already; remove it or name another")
        require_folder(path, "a bag")

    def add_topic(self, topic: str, type_name: str, latched: bool = False, depth: int = 10) -> None:
        """Announce a topic and its QoS before its first message; `latched`: transient local.

        A topic that is written without this is reliable, volatile, keep last 10. Raises RecordingError when the topic
        exists with another type or QoS, or the type has no definition here.
        """
        qos = qos_profile(latched, depth)
        known = self._topics.get(topic)
        if known is not None:
            if (known.type_name, known.qos) != (type_name, qos):
                raise RecordingError(
                    f"topic {topic} is already in {self.path} with type {known.type_name} or other QoS"
                )
            return
        if not topic.startswith("/"):
            raise RecordingError(f"topic {topic!r} must be absolute, such as /{topic}")
        if type_name not in self._schemas:
            text = schema_text(type_name).encode()
            self._schemas[type_name] = self._writer.register_schema(type_name, "ros2msg", text)
        record = TopicRecord(topic, type_name, type_hash(type_name), qos)
        self._channels[topic] = self._writer.register_channel(
            topic,
            "cdr",
            self._schemas[type_name],
            {"offered_qos_profiles": to_yaml(qos), "topic_type_hash": record.type_hash},
        )
        self._topics[topic] = record

    def write(self, topic: str, msg: Any, log_time_ns: int, publish_time_ns: int | None = None) -> None:
        """Append a message object. Raises RecordingError as `write_raw` does."""
        self.write_raw(topic, type_name_of(msg), serialize_message(msg), log_time_ns, publish_time_ns)

    def write_raw(
        self, topic: str, type_name: str, cdr: bytes, log_time_ns: int, publish_time_ns: int | None = None
    ) -> None:
        """Append a message in CDR, as a raw subscription hands it over.

        `log_time_ns`: when it was received; `publish_time_ns`: when it was sent, the same by default. Raises
        RecordingError on a topic of another type, bytes that are no CDR, a negative time, or a full disk.
        """
        if self._closed:
            raise RecordingError(f"the bag {self.path} is closed")
        known = self._topics.get(topic)
        if known is None:
            self.add_topic(topic, type_name)
            known = self._topics[topic]
        if known.type_name != type_name:
            raise RecordingError(f"topic {topic} holds {known.type_name} in {self.path}, not {type_name}")
        if len(cdr) < 4 or cdr[0] != 0:
            raise RecordingError(
                f"{len(cdr)} bytes for {topic} are no CDR message: its 4-byte encapsulation header is missing"
            )
        sent_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        if not (0 <= log_time_ns <= _LATEST_NS and 0 <= sent_ns <= _LATEST_NS):
            raise RecordingError(
                f"times of a message on {topic} must be nanoseconds since 1970, "
                f"got log {log_time_ns}, publish {sent_ns}"
            )
        try:
            self._writer.add_message(self._channels[topic], log_time_ns, bytes(cdr), sent_ns, known.message_count)
        except OSError as error:
            raise RecordingError(f"cannot write to {self.file}: {error}") from error
        known.message_count += 1
        self._start_ns, self._end_ns = min(self._start_ns, log_time_ns), max(self._end_ns, log_time_ns)

    def flush(self) -> None:
        """Close the chunk at hand and hand it to the operating system: what is written so far survives a kill."""
        try:
            self._writer.flush()
        except OSError as error:
            raise RecordingError(f"cannot write to {self.file}: {error}") from error

    def close(self) -> None:
        """Write indexes and metadata.yaml; a second call does nothing. Raises RecordingError on a full disk."""
        if self._closed:
            return
        self._closed = True
        empty = self._end_ns < self._start_ns
        start, end = (0, 0) if empty else (self._start_ns, self._end_ns)
        info = bag_information(self.file.name, start, end, list(self._topics.values()), self._custom_data)
        try:
            with self._stream:
                self._writer.add_metadata("rosbag2", {"serialized_metadata": to_yaml(info)})
                self._writer.finish()
                self._stream.flush()
                os.fsync(self._stream.fileno())
            unfinished = self.path / f"{FILE_NAME}.tmp"
            unfinished.write_text(to_yaml({"rosbag2_bagfile_information": info}), encoding="utf-8")
            unfinished.replace(self.path / FILE_NAME)
        except OSError as error:
            raise RecordingError(f"cannot finish the bag {self.path}: {error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
