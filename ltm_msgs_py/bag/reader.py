"""Read a bag: a rosbag2 folder of MCAP files, or one MCAP file."""

from __future__ import annotations

import heapq
import logging
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ltm_core.base.errors import RecordingError
from ltm_core.storage.disk_io import is_file, is_folder
from ltm_msgs_py.bag.mcap_index import McapIndex
from ltm_msgs_py.bag.metadata import bag_files, is_latched
from ltm_msgs_py.bag.schemas import message_class

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a bag. `latched`: its publisher was transient local. `encoding`: cdr in every ROS 2 bag."""

    type_name: str
    message_count: int
    latched: bool
    encoding: str


@dataclass(frozen=True)
class BagMessage:
    """One recorded message: `raw` is its CDR; received at `log_time_ns`, sent at `publish_time_ns`."""

    topic: str
    log_time_ns: int
    publish_time_ns: int
    type_name: str
    raw: bytes


class BagReader:
    """The topics and messages of a bag.

    A truncated or corrupt bag is read as far as possible; `damage` then says what is missing and at which byte, and it
    is logged as a warning. Later chunks are only checked when their messages are read, so check `damage` again
    afterwards.
    """

    def __init__(self, path: Path | str, allow_damaged: bool = True) -> None:
        """Open a bag folder or an .mcap file.

        Raises RecordingError when there is none, it is another format, or, without `allow_damaged`, it is damaged.
        """
        self.path = Path(path)
        self._notes: list[str] = []
        self._files = [McapIndex.open(file) for file in self._mcap_files()]
        self._topics = self._collect_topics()
        for note in self.damage:
            if not allow_damaged:
                raise RecordingError(note)
            _log.warning("%s", note)

    @property
    def damage(self) -> tuple[str, ...]:
        """Return unreadable parts so far, in words with byte offsets; empty for a complete bag."""
        return (*self._notes, *(note for file in self._files for note in file.damage))

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

        `topics`: only these (None: all); a topic that is not in the bag gives no messages.
        """
        # Files of a long recording follow each other: only those that overlap in time are open together.
        waiting = sorted(
            (f for f in self._files if f.start_ns is not None), key=lambda f: f.start_ns or 0, reverse=True
        )
        order = {id(file): number for number, file in enumerate(self._files)}
        heads: list[tuple[int, int, BagMessage, Iterator[BagMessage]]] = []

        def advance(number: int, stream: Iterator[BagMessage]) -> None:
            if (message := next(stream, None)) is not None:
                heapq.heappush(heads, (message.log_time_ns, number, message, stream))

        while waiting or heads:
            while waiting and (not heads or (waiting[-1].start_ns or 0) <= heads[0][0]):
                file = waiting.pop()
                advance(order[id(file)], self._messages_of(file, topics, start_ns, end_ns))
            if heads:
                _, number, message, stream = heapq.heappop(heads)
                yield message
                advance(number, stream)

    def _messages_of(
        self, file: McapIndex, topics: Collection[str] | None, start_ns: int | None, end_ns: int | None
    ) -> Iterator[BagMessage]:
        wanted = {i for i, c in file.channels.items() if topics is None or c.topic in topics}
        for channel, message in file.messages(wanted, start_ns, end_ns):
            type_name = self._topics[channel.topic].type_name
            yield BagMessage(channel.topic, message.log_time, message.publish_time, type_name, message.data)

    def decode(self, message: BagMessage) -> Any:
        """Return the message object of the standard Python interface.

        Raises RecordingError for a type that is not installed, an encoding other than CDR, or invalid bytes.
        """
        info = self._topics.get(message.topic)
        if info is not None and info.encoding != "cdr":
            raise RecordingError(f"{message.topic} in {self.path} is encoded as {info.encoding!r}, only cdr is read")
        from rclpy.serialization import deserialize_message  # callers that only use bytes need not load the middleware

        cls = message_class(message.type_name)
        try:
            return deserialize_message(message.raw, cls)
        except Exception as error:  # RMWError is the binding's own; std::bad_alloc comes as MemoryError
            raise RecordingError(
                f"{message.topic} at {message.log_time_ns} ns in {self.path}: {len(message.raw)} bytes do not decode "
                f"as {message.type_name} ({str(error).splitlines()[0]})"
            ) from error

    def _mcap_files(self) -> list[Path]:
        if is_file(self.path):
            return [self.path]
        if not is_folder(self.path):
            raise RecordingError(f"no bag at {self.path}: give a bag folder or an .mcap file")
        files = bag_files(self.path)
        if files is not None:
            return files
        files = sorted(self.path.glob("*.mcap"), key=lambda p: (len(p.name), p.name))  # _2 before _10
        if not files:
            raise RecordingError(f"{self.path} is not a bag: it has neither metadata.yaml nor an .mcap file")
        self._notes.append(f"{self.path} has no metadata.yaml: its recording was not finished; reading its .mcap files")
        return files

    def _collect_topics(self) -> dict[str, TopicInfo]:
        topics: dict[str, TopicInfo] = {}
        for file in self._files:
            for channel_id, channel in sorted(file.channels.items()):
                schema = file.schemas.get(channel.schema_id)
                type_name = schema.name if schema is not None else ""
                known = topics.get(channel.topic)
                if known is not None and known.type_name != type_name:
                    raise RecordingError(
                        f"topic {channel.topic} in {self.path} has two types: {known.type_name} and {type_name}"
                    )
                topics[channel.topic] = TopicInfo(
                    type_name,
                    file.counts.get(channel_id, 0) + (known.message_count if known else 0),
                    is_latched(channel.metadata.get("offered_qos_profiles", "")) or bool(known and known.latched),
                    channel.message_encoding,
                )
        return topics
