"""Write one MCAP file of a bag, which stays readable even if the disk fails."""

import fcntl
import os
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from mcap.writer import CompressionType, Writer

from ltm_core.base.errors import RecordingError
from ltm_core.storage.disk_io import DiskReserve, sync
from ltm_msgs_py.bag.metadata import FileRecord, TopicRecord, to_yaml
from ltm_msgs_py.bag.repair import finish_cut_file
from ltm_msgs_py.bag.schemas import schema_text

RESERVE_BYTES = 1 << 20
"""Bytes reserved beside the file, so that its index can be written on a full disk."""


class _Unbuffered:
    """A file in which every write is complete or an error, and whose size is known."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        # Locked, so that a cleanup of old recordings leaves files that are being written.
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
        """Do nothing; nothing is buffered."""

    def close(self) -> None:
        self._file.close()


class McapFile:
    """Messages go into chunks; a chunk is handed to the operating system when it is full, or at `flush`.

    All raise OSError if the disk fails; then `abandon` ends the file after its last whole chunk, and `unsaved` messages
    were lost. `record`: metadata of what is saved. `first_ns`: log time of the first message."""

    def __init__(
        self, path: Path, compression: CompressionType, chunk_size: int, library: str, saved: Counter[str]
    ) -> None:
        """Create the file. `saved`: gets new messages by topic that the system has. Raises OSError, and leaves no file
        then."""
        self.path, self._saved = path, saved
        self.first_ns: int | None = None
        self.record = FileRecord(path.name, 0, 0, Counter())
        self._waiting: list[tuple[str, int, bool]] = []
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._holds_new = False
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
        """Return the bytes in the file."""
        return self._stream.size

    @property
    def unsaved(self) -> int:
        """Return the number of new messages that wait for their chunk."""
        return sum(new for _, _, new in self._waiting)

    def add_topic(self, record: TopicRecord) -> None:
        """Add a topic. Raises RecordingError if the type has no definition here, OSError."""
        if record.type_name not in self._schemas:
            text = schema_text(record.type_name).encode()
            self._schemas[record.type_name] = self._writer.register_schema(record.type_name, "ros2msg", text)
        metadata = {"offered_qos_profiles": to_yaml(record.qos), "topic_type_hash": record.type_hash}
        schema = self._schemas[record.type_name]
        self._channels[record.topic] = self._writer.register_channel(record.topic, "cdr", schema, metadata)
        self._note_chunks()

    def write(self, topic: str, cdr: bytes, log_time_ns: int, publish_time_ns: int, new: bool = True) -> None:
        """Append a message of an added topic; `new`: not repeated from an earlier file."""
        if self.first_ns is None:
            self.first_ns = log_time_ns
        self._waiting.append((topic, log_time_ns, new))
        self._writer.add_message(self._channels[topic], log_time_ns, cdr, publish_time_ns)
        self._note_chunks()

    def flush(self) -> None:
        """Write the current chunk to the operating system."""
        self._writer.flush()
        self._note_chunks()

    def finish(self, metadata: Mapping[str, str]) -> None:
        """Write the index, wait for the disk and close the file. `metadata`: the record that rosbag2 writes."""
        self._reserve.give_up()
        self._writer.add_metadata("rosbag2", dict(metadata))
        self._writer.finish()
        sync(self.path)
        self._stream.close()

    def abandon(self) -> bool:
        """End the file after its last complete chunk, after an OSError; delete it and return False without new
        messages.

        If even that fails, the file ends at that chunk without an index, and BagReader can read it."""
        self._reserve.give_up()
        with suppress(OSError):
            self._stream.close()
        with suppress(OSError, RecordingError):
            if self._holds_new:
                os.truncate(self.path, self._whole)
                finish_cut_file(self.path)
            else:
                self.path.unlink()
        return self._holds_new

    def _note_chunks(self) -> None:
        """Detect chunks that the library has ended, by the growth of the file."""
        if self._stream.size == self._whole:
            return
        self._whole = self._stream.size
        if not self._waiting:
            return
        record, times = self.record, [time for _, time, _ in self._waiting]
        record.start_ns = min(times) if not record.counts else min(record.start_ns, *times)
        record.end_ns = max(record.end_ns, *times)
        record.counts.update(topic for topic, _, _ in self._waiting)
        self._holds_new |= self.unsaved > 0
        self._saved.update(topic for topic, _, new in self._waiting if new)
        self._waiting.clear()
