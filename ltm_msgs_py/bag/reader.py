"""Read a bag: a rosbag2 folder of MCAP or SQLite files, or one such file, also compressed as a whole (zstd)."""

import heapq
import logging
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import zstandard
from mcap.records import Channel, Message, Schema

from ltm_core.base.errors import RecordingError
from ltm_core.storage.disk_io import is_file, is_folder
from ltm_msgs_py.bag.cdr import TF_TYPE, Transforms, transforms_of
from ltm_msgs_py.bag.mcap_index import LARGEST_MESSAGE, FileIndex, McapIndex
from ltm_msgs_py.bag.metadata import bag_files, is_latched
from ltm_msgs_py.bag.schemas import message_class

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a bag; `type_name`: the first of several. `latched`: its publisher was transient local."""

    type_name: str
    message_count: int
    latched: bool


@dataclass(frozen=True)
class BagMessage:
    """One recorded message: its bytes, received at `log_time_ns`, sent at `publish_time_ns`, in `encoding`."""

    topic: str
    log_time_ns: int
    publish_time_ns: int
    type_name: str
    raw: bytes
    encoding: str = "cdr"


class Logged(Protocol):
    @property
    def log_time_ns(self) -> int: ...


MessageT = TypeVar("MessageT", bound=Logged)


_SQLITE = b"SQLite format 3\0"


class SqliteIndex(FileIndex):
    """The channels and messages of a rosbag2 SQLite file, read through `rosbags`."""

    def __init__(self, path: Path, reader: Any) -> None:
        super().__init__(path)
        self._reader = reader
        for one in reader.connections:
            latched = any(qos.durability.name == "TRANSIENT_LOCAL" for qos in one.ext.offered_qos_profiles)
            metadata = {"offered_qos_profiles": "[{durability: transient_local}]"} if latched else {}
            self.schemas[one.id] = Schema(one.id, b"", "", one.msgtype)
            self.channels[one.id] = Channel(one.id, one.topic, one.ext.serialization_format, metadata, one.id)
            self.counts[one.id] = one.msgcount
        if reader.message_count:
            self.start_ns, self.end_ns = reader.start_time, reader.end_time - 1

    @classmethod
    def open(cls, path: Path) -> "SqliteIndex":
        """Open a file. Raises RecordingError if it is invalid, or rosbags is not installed."""
        try:
            from rosbags.rosbag2 import Reader
        except ImportError as error:
            raise RecordingError(f"{path} is an SQLite bag; to read it, run pip install 'ltm[bags]'") from error
        try:
            reader = Reader(path)
            reader.open()
            return cls(path, reader)
        except Exception as error:  # rosbags, its SQLite, and invalid content raise errors of many kinds
            raise RecordingError(f"{path} cannot be read as an SQLite bag ({type(error).__name__}: {error})") from error

    def messages(
        self, channel_ids: Collection[int], start_ns: int | None, end_ns: int | None
    ) -> Iterator[tuple[Channel, Message]]:
        """Yield messages as `McapIndex.messages`; a corrupt part ends the file and is noted in `damage`."""
        wanted = [one for one in self._reader.connections if one.id in channel_ids]
        found = self._reader.messages(wanted, start_ns, end_ns) if wanted else iter(())
        while True:
            try:
                one, time, raw = next(found)
            except StopIteration:
                return
            except Exception as error:  # as above
                note = f"{self.path}: the rest is corrupt and ignored ({type(error).__name__}: {error})"
                if note not in self.damage:
                    self.damage.append(note)
                    self.lost[""] += 1
                return
            yield self.channels[one.id], Message(one.id, time, raw, time, 0)


def is_bag_file(name: str) -> bool:
    """Return whether a file's name is that of a bag's file, also of a compressed one."""
    return name.removesuffix(".zstd").endswith((".mcap", ".db3"))


def _plain(raw: bytes) -> bytes:
    """Return a message's CDR, which rosbag2 may compress message by message; unchanged if invalid or too large."""
    if not raw.startswith(zstandard.FRAME_HEADER):
        return raw
    try:
        if zstandard.frame_content_size(raw) > LARGEST_MESSAGE:  # zstandard allocates what a frame states
            return raw
        return bytes(zstandard.ZstdDecompressor().decompress(raw, max_output_size=LARGEST_MESSAGE))
    except zstandard.ZstdError:
        return raw


class BagReader:
    """The topics and messages of a bag.

    A truncated or corrupt bag is read as far as possible; `damage` then says what is missing, and it is logged as a
    warning. Chunks are only checked when their messages are read, so check `damage` and `lost` again afterwards."""

    def __init__(self, path: Path | str, allow_damaged: bool = True, names: Mapping[str, str] | None = None) -> None:
        """Open a bag folder or one of its files. `names`: other names of its topics.

        Raises RecordingError when there is none, it is another format, or, without `allow_damaged`, it is damaged."""
        self.path = Path(path)
        self._names = dict(names or {})
        self._notes: list[str] = []
        self._unpacked: list[tempfile.TemporaryDirectory[str]] = []
        self._files = [self._opened(file) for file in self._storage_files()]
        self._topics = self._collect_topics()
        self._logged = 0
        if self.damage and not allow_damaged:
            raise RecordingError(self.damage[0])
        self._log_damage()

    @property
    def damage(self) -> tuple[str, ...]:
        """Return unreadable parts so far, in words with byte offsets, times and topics; empty for a complete bag."""
        return (*self._notes, *(note for file in self._files for note in file.damage))

    @property
    def lost(self) -> Counter[str]:
        """Return the messages of unreadable parts so far, by topic; under "", one for each part of unknown content."""
        lost = sum((file.lost for file in self._files), Counter[str]())
        return Counter({self._names.get(topic, topic): count for topic, count in lost.items()})

    @property
    def unread(self) -> tuple[str, ...]:
        """Return parts that the system failed to read, maybe temporarily."""
        return tuple(note for file in self._files for note in file.unread)

    @property
    def start_ns(self) -> int | None:
        """Return the log time of the first message; None for an empty bag."""
        return min((f.start_ns for f in self._files if f.start_ns is not None), default=None)

    @property
    def end_ns(self) -> int | None:
        """Return the log time of the last message; None for an empty bag."""
        return max((f.end_ns for f in self._files if f.end_ns is not None), default=None)

    def topics(self) -> dict[str, str]:
        """Return type names by topic."""
        return {topic: info.type_name for topic, info in self._topics.items()}

    def topic_infos(self) -> dict[str, TopicInfo]:
        """Return type, message count and QoS by topic."""
        return dict(self._topics)

    def messages(
        self, topics: Collection[str] | None = None, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[BagMessage]:
        """Yield messages with start_ns <= log time < end_ns by log time; equal times in file order.

        `topics`: only these (None: all); a topic that is not in the bag gives no messages."""

        def of_file(number: int) -> Iterator[BagMessage]:
            file = self._files[number]
            wanted = {i for i, c in file.channels.items() if topics is None or self._named(c) in topics}
            for channel, message in file.messages(wanted, start_ns, end_ns):
                kind = self._named(channel), message.log_time, message.publish_time, file.type_of(channel)
                yield BagMessage(*kind, _plain(message.data), channel.message_encoding)
            self._log_damage()

        for _, message in by_log_time([file.start_ns for file in self._files], of_file):
            yield message

    def _named(self, channel: Channel) -> str:
        topic: str = channel.topic
        return self._names.get(topic, topic)

    def _log_damage(self) -> None:
        for note in self.damage[self._logged :]:
            _log.warning("%s", note)
        self._logged = len(self.damage)

    def decode(self, message: BagMessage) -> Any:
        """Return the message object of the standard Python interface.

        Raises RecordingError for a type that is not installed, an encoding other than CDR, or invalid bytes."""
        try:
            return decoded(message.raw, message.type_name, message.encoding)
        except RecordingError as error:
            raise RecordingError(f"{message.topic} at {message.log_time_ns} ns in {self.path}: {error}") from error

    def _storage_files(self) -> list[Path]:
        if is_file(self.path):
            return [self.path]
        if not is_folder(self.path):
            raise RecordingError(f"no bag at {self.path}: give a bag folder, or an .mcap or .db3 file")
        files = bag_files(self.path)
        if files is not None:
            return files
        found = (path for path in self.path.iterdir() if is_bag_file(path.name))
        files = sorted(found, key=lambda p: (len(p.name), p.name))  # _2 before _10
        if not files:
            raise RecordingError(f"{self.path} is not a bag: it has neither metadata.yaml nor an .mcap or .db3 file")
        self._notes.append(f"{self.path} has no metadata.yaml: its recording was not finished; reading its files")
        return files

    def _opened(self, path: Path) -> McapIndex | SqliteIndex:
        """Open a file by its first bytes; one that is compressed as a whole is unpacked. Raises RecordingError."""
        try:
            with path.open("rb") as source:
                magic = source.read(len(_SQLITE))
                if magic.startswith(zstandard.FRAME_HEADER):
                    source.seek(0)
                    self._unpacked.append(tempfile.TemporaryDirectory(prefix="ltm_bag_"))
                    path = Path(self._unpacked[-1].name) / path.name.removesuffix(".zstd")
                    with path.open("w+b") as whole:
                        zstandard.ZstdDecompressor().copy_stream(source, whole)
                        whole.seek(0)
                        magic = whole.read(len(_SQLITE))
            return SqliteIndex.open(path) if magic == _SQLITE else McapIndex.open(path)
        except (OSError, zstandard.ZstdError) as error:
            raise RecordingError(f"cannot read {path}: {error}") from error

    def _collect_topics(self) -> dict[str, TopicInfo]:
        topics: dict[str, TopicInfo] = {}
        for file in self._files:
            for channel_id, channel in sorted(file.channels.items()):
                known = topics.get(name := self._named(channel))
                topics[name] = TopicInfo(
                    known.type_name if known else file.type_of(channel),
                    file.counts.get(channel_id, 0) + (known.message_count if known else 0),
                    is_latched(channel.metadata.get("offered_qos_profiles", "")) or bool(known and known.latched),
                )
        return topics


def by_log_time(
    begins: Sequence[int | None], stream_of: Callable[[int], Iterator[MessageT]]
) -> Iterator[tuple[int, MessageT]]:
    """Merge streams by log time, equal times in their order; yield each message after the number of its stream.

    `begins`: of each stream, None: empty. Only streams that overlap in time are open together."""
    waiting = sorted(((begin, number) for number, begin in enumerate(begins) if begin is not None), reverse=True)
    heads: list[tuple[int, int, MessageT, Iterator[MessageT]]] = []
    while waiting or heads:
        if waiting and (not heads or waiting[-1][0] <= heads[0][0]):
            _, number = waiting.pop()
            stream = stream_of(number)
        else:
            _, number, message, stream = heapq.heappop(heads)
            yield number, message
        if (following := next(stream, None)) is not None:
            heapq.heappush(heads, (following.log_time_ns, number, following, stream))


def decoded(raw: bytes, type_name: str, encoding: str = "cdr") -> Any:
    """Return the message object of serialised bytes.

    Raises RecordingError for a type that is not installed, an encoding other than CDR, or invalid bytes."""
    if encoding != "cdr":
        raise RecordingError(f"{type_name or 'a message'} is encoded as {encoding!r}; only cdr (ROS 2) is read")
    if type_name == TF_TYPE:
        return Transforms(transforms_of(raw))
    from rclpy.serialization import deserialize_message  # callers that only use bytes need not load the middleware

    cls = message_class(type_name)
    try:
        return deserialize_message(raw, cls)
    except Exception as error:  # RMWError is the binding's own; std::bad_alloc comes as MemoryError
        why = (str(error).splitlines() or [type(error).__name__])[0]
        raise RecordingError(f"{len(raw)} bytes do not decode as {type_name} ({why})") from error
