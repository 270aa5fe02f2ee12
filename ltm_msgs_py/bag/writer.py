"""Write a bag: MCAP files and their metadata.yaml, in rosbag2's layout."""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Self

from mcap.writer import LIBRARY_IDENTIFIER, CompressionType

from ltm_core.base.errors import RecordingError
from ltm_core.storage.disk_io import is_folder, is_there, require_folder
from ltm_msgs_py.bag.mcap_file import McapFile
from ltm_msgs_py.bag.mcap_index import LATEST_NS
from ltm_msgs_py.bag.metadata import FileRecord, TopicRecord, bag_information, qos_profile, to_yaml, write_metadata
from ltm_msgs_py.bag.schemas import schema_text, type_hash, type_name_of


@dataclass(frozen=True)
class Split:
    """Limits at which the next file of a bag begins. A file exceeds `most_bytes` by a chunk at most."""

    most_bytes: int
    longest_ns: int


class BagWriter:
    """Writes `<path>/<name>_0.mcap`, `_1` and so on and, when closed, `<path>/metadata.yaml`.

    A context manager; not for several threads at once. A chunk is on disk once it is full (`chunk_size` bytes before
    compression) or `flush` is called, and an interrupted file can be read up to its last chunk. metadata.yaml appears
    in one step at the very end: a bag that has one is complete.

    Where the disk fails (full, quota, defect), the file at hand is ended after its last whole chunk, so that every
    reader takes it; the messages of the chunk that could not be written are counted in `lost`, and the next message
    begins the next file, as soon as one can be made. Each file but the first begins with the last message of every
    latched topic, so that it can be read without those before it."""

    def __init__(
        self,
        path: Path | str,
        compression: CompressionType = CompressionType.ZSTD,
        custom_data: Mapping[str, str] | None = None,
        chunk_size: int = 1 << 20,
        split: Split | None = None,
        library: str = LIBRARY_IDENTIFIER,
        before_file: Callable[[], None] = lambda: None,
    ) -> None:
        """`custom_data`: for metadata.yaml. `split`: None for one file. `library`: who writes. `before_file`: called
        before each file is made.

        Raises RecordingError when `path` exists and is not an empty folder."""
        self.path = Path(path)
        _require_absent(self.path)
        self.on_disk: Counter[str] = Counter()
        """Messages by topic that the operating system has, without those repeated in a further file."""
        self.lost = 0
        """Number of messages that the disk did not take."""
        self._compression, self._chunk_size, self._split = compression, chunk_size, split
        self._library, self._before_file = library, before_file
        self._custom_data = dict(custom_data or {})
        self._topics: dict[str, TopicRecord] = {}
        self._latched: dict[str, tuple[bytes, int] | None] = {}
        self._finished: list[FileRecord] = []
        self._file: McapFile | None = None
        self._next = 0
        self._closed = False
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(f"cannot write a bag to {self.path}: {error}") from error
        self._next_file(0)

    @staticmethod
    def require_free(path: Path, overwrite: bool = False) -> None:
        """Raise RecordingError unless `path` does not exist or is an empty folder, ConfigError if it cannot be written
        now.

        `overwrite`: first delete a bag that is there, if the folder holds nothing else."""
        if overwrite and is_folder(path):
            try:
                files = list(path.iterdir())
                if all(f.is_file() and (f.name == "metadata.yaml" or f.suffix == ".mcap") for f in files):
                    for file in files:
                        file.unlink()
            except OSError as error:
                raise RecordingError(f"cannot replace the bag {path}: {error}") from error
        _require_absent(path)
        require_folder(path, "a bag")

    @property
    def file_bytes(self) -> int:
        """Return the bytes in the current file; 0 between files."""
        return 0 if self._file is None else self._file.size

    def add_topic(self, topic: str, type_name: str, latched: bool = False, depth: int = 10) -> None:
        """Announce a topic and its QoS before its first message; `latched`: transient local.

        A topic that is written without this is reliable, volatile, keep last 10. Raises RecordingError when the topic
        exists with another type or QoS, or the type has no definition here."""
        qos = qos_profile(latched, depth)
        known = self._topics.get(topic)
        if known is not None:
            if (known.type_name, known.qos) != (type_name, qos):
                raise RecordingError(f"{topic} is already in {self.path} with type {known.type_name} or other QoS")
            return
        if not topic.startswith("/"):
            raise RecordingError(f"topic {topic!r} must be absolute, such as /{topic}")
        schema_text(type_name)
        record = self._topics[topic] = TopicRecord(topic, type_name, type_hash(type_name), qos)
        if latched:
            self._latched[topic] = None
        self._with_file(lambda file: file.add_topic(record))

    def write(self, topic: str, msg: Any, log_time_ns: int, publish_time_ns: int | None = None) -> None:
        """Append a message object. Raises RecordingError as `write_raw` does."""
        from rclpy.serialization import serialize_message  # who only reads bags need not load the middleware

        self.write_raw(topic, type_name_of(msg), serialize_message(msg), log_time_ns, publish_time_ns)

    def write_raw(
        self, topic: str, type_name: str, cdr: bytes, log_time_ns: int, publish_time_ns: int | None = None
    ) -> None:
        """Append a message in CDR, as a raw subscription hands it over.

        `log_time_ns`: when it was received; `publish_time_ns`: when it was sent, the same by default. Raises
        RecordingError on a topic of another type, bytes that are no CDR, a negative time, or a full disk."""
        if self._closed:
            raise RecordingError(f"the bag {self.path} is closed")
        if topic not in self._topics:
            self.add_topic(topic, type_name)
        known = self._topics[topic]
        if known.type_name != type_name:
            raise RecordingError(f"topic {topic} holds {known.type_name} in {self.path}, not {type_name}")
        if len(cdr) < 4 or cdr[0] != 0:
            raise RecordingError(f"{len(cdr)} bytes for {topic} are not a CDR message: they have no encapsulation")
        sent_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        if not (0 <= log_time_ns <= LATEST_NS and 0 <= sent_ns <= LATEST_NS):
            what = f"times of a message on {topic} must be nanoseconds since 1970"
            raise RecordingError(f"{what}, got log {log_time_ns}, publish {sent_ns}")
        try:
            if self._file is not None and self._split is not None and self._file.first_ns is not None:
                age = log_time_ns - self._file.first_ns
                if self._file.size >= self._split.most_bytes or age >= self._split.longest_ns:
                    self.end_file()
            if self._file is None:
                self._next_file(log_time_ns)
        except RecordingError:
            self.lost += 1
            raise
        if topic in self._latched:
            self._latched[topic] = bytes(cdr), sent_ns
        self._with_file(lambda file: file.write(topic, bytes(cdr), log_time_ns, sent_ns))

    def flush(self) -> None:
        """Write the current chunk to the operating system: everything written so far survives a kill."""
        self._with_file(McapFile.flush)

    def end_file(self) -> None:
        """Finish the current file; the next message begins another. Raises RecordingError as `flush`."""
        self._with_file(self._finish)

    def _finish(self, file: McapFile) -> None:
        file.flush()
        info = bag_information([file.record], list(self._topics.values()), self._custom_data)
        file.finish({"serialized_metadata": to_yaml(info)})
        self._let_go(file.record)

    def close(self) -> None:
        """Finish the last file and write metadata.yaml, once. Raises RecordingError on a full disk."""
        if self._closed:
            return
        self._closed = True
        try:
            self.end_file()
        finally:
            try:
                if files := self._still_there():
                    topics = list(self._topics.values())
                    write_metadata(self.path, bag_information(files, topics, self._custom_data))
            except OSError as error:
                raise RecordingError(f"cannot finish the bag {self.path}: {error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _next_file(self, log_time_ns: int) -> None:
        """Begin the next file with all topics, and with the latched messages."""
        try:
            self._before_file()
            path = self.path / f"{self.path.resolve().name}_{self._next}.mcap"
            self._file = McapFile(path, self._compression, self._chunk_size, self._library, self.on_disk)
        except OSError as error:
            raise RecordingError(f"cannot write a bag to {self.path}: {error}") from error
        self._next += 1
        self._with_file(partial(self._begin, log_time_ns))

    def _begin(self, log_time_ns: int, file: McapFile) -> None:
        for record in self._topics.values():
            file.add_topic(record)
        for topic, last in self._latched.items():
            if last is not None:
                cdr, sent_ns = last
                file.write(topic, cdr, log_time_ns, sent_ns, new=False)

    def _with_file(self, work: Callable[[McapFile], None]) -> None:
        """Call `work` with the current file, if any; end the file on a disk error. Raises RecordingError then."""
        if (file := self._file) is None:
            return
        try:
            work(file)
        except OSError as error:
            record = file.record if file.abandon() else None
            self.lost += file.unsaved
            self._let_go(record)
            kept = 0 if record is None else record.counts.total()
            raise RecordingError(
                f"cannot write to {file.path}: {error.strerror or error}; {file.unsaved} messages are lost, the {kept} "
                "before them are in it; what comes next goes into another file"
            ) from error

    def _let_go(self, record: FileRecord | None) -> None:
        """Drop the current file after its end; None: it held nothing and is deleted."""
        self._file = None
        self._finished = [*self._still_there(), *([] if record is None else [record])]

    def _still_there(self) -> list[FileRecord]:
        """Remove the files that the ring has deleted from the bag's list."""
        return [record for record in self._finished if (self.path / record.name).exists()]


def _require_absent(path: Path) -> None:
    if is_there(path) and not (is_folder(path) and not any(path.iterdir())):
        raise RecordingError(f"cannot write a bag to {path}: it exists already; remove it or name another")
