"""One MCAP file of a bag while it is written: it ends whole, also where the disk fails."""

from __future__ import annotations

import fcntl
import os
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from mcap.writer import CompressionType, Writer

from ltm_core.storage.disk_io import DiskReserve
from ltm_msgs_py.bag.metadata import FileRecord, TopicRecord, to_yaml
from ltm_msgs_py.bag.repair import finish_cut_file
from ltm_msgs_py.bag.schemas import schema_text

RESERVE_BYTES = 1 << 20
"""Held beside the file, so that its index can be written on a full disk."""


class _Unbuffered:
    """A file in which every write is whole or an error, and whose size is known."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        # Whoever removes old recordings leaves alone what somebody still writes.
        with suppress(OSError):  # not every network's file system has locks
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self.size = 0

    def write(self, data: bytes) -> int:
        left = memoryview(data)
        while left:
            written = self._file.write(left)
            self.size += written
            left = left[written:]
        return len(data)

    def tell(self) -> int:
        return self.size

    def flush(self) -> None:
        """Nothing waits here."""

    def sync(self) -> None:
        os.fsync(self._file.fileno())

    def close(self) -> None:
        self._file.close()


class McapFile:
    """Messages go into chunks; a chunk is handed to the operating system when it is full, or at `flush`.

    `add_topic`, `write`, `flush` and `finish` raise OSError where the disk fails; then `abandon` ends the file after
    its last whole chunk, and `unsaved` is how many messages were lost.
    """

    def __init__(self, path: Path, compression: CompressionType, chunk_size: int, library: str) -> None:
        """A new file. Raises OSError, and leaves none then."""
        self.path = path
        self.saved: Counter[str] = Counter()
        """New messages by topic that the operating system has: a killed process does not lose them."""
        self.first_ns: int | None = None
        """Log time of the first message."""
        self._record = FileRecord(path.name, 0, 0, Counter())
        self._waiting: list[tuple[str, int, bool]] = []
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._stream = _Unbuffered(path)
        self._reserve = DiskReserve(path.with_name(f".{path.name}.reserve"))
        try:
            self._writer = Writer(self._stream, chunk_size=chunk_size, compression=compression)
            self._writer.start(profile="ros2", library=library)
        except OSError:
            self._stream.close()
            path.unlink()
            raise
        self._reserve.hold(RESERVE_BYTES)
        self._whole = self._stream.size

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._stream.size

    @property
    def unsaved(self) -> int:
        """New messages that wait for their chunk."""
        return sum(new for _, _, new in self._waiting)

    @property
    def record(self) -> FileRecord:
        """What the bag's metadata says of the file, by what is saved."""
        return replace(self._record, counts=self._record.counts.copy())

    def add_topic(self, record: TopicRecord) -> None:
        """Raises RecordingError where the type has no definition here, OSError."""
        if record.type_name not in self._schemas:
            text = schema_text(record.type_name).encode()
            self._schemas[record.type_name] = self._writer.register_schema(record.type_name, "ros2msg", text)
        metadata = {"offered_qos_profiles": to_yaml(record.qos), "topic_type_hash": record.type_hash}
        schema = self._schemas[record.type_name]
        self._channels[record.topic] = self._writer.register_channel(record.topic, "cdr", schema, metadata)
        self._note_chunks()

    def write(
        self, topic: str, cdr: bytes, log_time_ns: int, publish_time_ns: int, sequence: int, new: bool = True
    ) -> None:
        """Append a message of a topic that was added; `new`: not a repetition of what a file before this one has."""
        if self.first_ns is None:
            self.first_ns = log_time_ns
        self._waiting.append((topic, log_time_ns, new))
        self._writer.add_message(self._channels[topic], log_time_ns, cdr, publish_time_ns, sequence)
        self._note_chunks()

    def flush(self) -> None:
        """Hand the chunk at hand to the operating system."""
        self._writer.flush()
        self._note_chunks()

    def finish(self, metadata: Mapping[str, str]) -> FileRecord:
        """Write the index and wait for the disk; the file is closed. `metadata`: the record that rosbag2 writes."""
        self.flush()
        self._reserve.give_up()
        self._writer.add_metadata("rosbag2", dict(metadata))
        self._writer.finish()
        self._stream.sync()
        self._stream.close()
        return self.record

    def abandon(self) -> FileRecord | None:
        """After an OSError: end the file after its last whole chunk and close it; None where it holds nothing new.

        Where not even that can be written, the file ends at that chunk without an index, and BagReader reads it.
        """
        self._reserve.give_up()
        with suppress(OSError):
            self._stream.close()
        if not self.saved:
            with suppress(OSError):
                self.path.unlink()
            return None
        try:
            os.truncate(self.path, self._whole)
            finish_cut_file(self.path)
        except OSError:
            with suppress(OSError):
                os.truncate(self.path, self._whole)
        return self.record

    def _note_chunks(self) -> None:
        """Chunks are ended by the library; the file has grown where it ended one."""
        if self._stream.size == self._whole:
            return
        self._whole = self._stream.size
        if not self._waiting:
            return
        record, times = self._record, [time for _, time, _ in self._waiting]
        record.start_ns = min(times) if not record.counts else min(record.start_ns, *times)
        record.end_ns = max(record.end_ns, *times)
        record.counts.update(topic for topic, _, _ in self._waiting)
        self.saved.update(topic for topic, _, new in self._waiting if new)
        self._waiting.clear()
