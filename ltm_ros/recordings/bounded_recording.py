"""Record with room left on the disk: a ring of files, written by a thread of its own."""

from __future__ import annotations

import errno
import math
import os
import queue
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ltm_core.base.errors import LtmError, RecordingError
from ltm_core.storage.disk_io import SpaceFloor, disk_bytes
from ltm_msgs_py.bag.ring import RecordingRing
from ltm_msgs_py.bag.writer import BagWriter, Split
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.heartbeat import HEARTBEAT
from ltm_ros.runtime.retry import Backoff

RING_BYTES, RING_SHARE = 16_000_000_000, 0.5
"""Of recordings by default: the lesser of the bytes and of the share of the disk."""
FLOOR_BYTES, FLOOR_SHARE = 2_000_000_000, 0.1
"""Free space that a recording leaves by default, likewise."""
RETRY_S, LONGEST_RETRY_S = 1.0, 15.0
"""First and longest pause after the disk has failed."""


@dataclass(frozen=True)
class RecordingLimits:
    """`most_bytes`: of all recordings that are not kept, None: any. `floor`: bytes that stay free. `split`: when the
    next file begins."""

    most_bytes: int | None
    floor: int
    split: Split

    @classmethod
    def of(
        cls, path: Path, max_bytes: int, min_free_bytes: int, file_bytes: int, file_seconds: float
    ) -> RecordingLimits:
        """What a configuration means on the disk of `path`. Raises RecordingError where the disk cannot be asked."""
        try:
            disk = disk_bytes(path)
        except OSError as error:
            raise RecordingError(f"cannot read the disk usage of {path}: {error}") from error
        most = min(RING_BYTES, int(RING_SHARE * disk)) if max_bytes < 0 else max_bytes or None
        floor = min(FLOOR_BYTES, int(FLOOR_SHARE * disk)) if min_free_bytes < 0 else min_free_bytes
        size = file_bytes if most is None else max(1, min(file_bytes, most // 4))
        return cls(most, floor, Split(size, int(file_seconds * 1e9)))


class BoundedRecording:
    """Writes messages into bags; for one thread. Raises nothing where the disk fails: it is told to `health`.

    Published is what the operating system has. What it has not taken is dropped as `disk` (an error of the disk) or
    `disk_low` (less free than the floor).
    """

    def __init__(
        self, path: Path, recorder: str, limits: RecordingLimits, health: Health, tell: Callable[[str], None]
    ) -> None:
        """`tell`: one line each time that recording stops or goes on.

        Raises RecordingError where no bag can be made for another reason than a disk that is full just now.
        """
        self._limits, self._health, self._tell = limits, health, tell
        self._ring = RecordingRing(path, recorder, limits.most_bytes)
        self._floor = SpaceFloor(path, limits.floor)
        self._path = path
        self._topics: dict[str, tuple[str, bool]] = {}
        self._held: dict[str, bytes] = {}
        self._writer: BagWriter | None = None
        self._told: Counter[str] = Counter()
        self._failed = ""
        self._retry_at = 0.0
        self._backoff = Backoff(RETRY_S, LONGEST_RETRY_S)
        for folder in self._ring.repair():
            self._tell(f"{folder} was not finished; it now ends with its last complete chunk")
        try:
            self._open()
        except RecordingError as error:
            if getattr(error.__cause__, "errno", None) not in (errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EROFS):
                raise
            self._fail(error)

    def add_topic(self, topic: str, type_name: str, latched: bool) -> None:
        """Announce a topic. Raises RecordingError on a type that is not known here."""
        if self._writer is not None:
            try:
                self._writer.add_topic(topic, type_name, latched)
            except RecordingError as error:
                if not isinstance(error.__cause__, OSError):
                    raise
                self._fail(error)
        self._topics[topic] = type_name, latched

    def write(self, topic: str, type_name: str, cdr: bytes, log_time_ns: int) -> None:
        """Take a message. Raises RecordingError on one that can be in no bag."""
        if self._low():
            self._refuse("disk_low", self._why_low(), topic, cdr)
            return
        if time.monotonic() < self._retry_at:
            self._refuse("disk", self._failed, topic, cdr)
            return
        try:
            writer = self._writer or self._open()
        except RecordingError as error:
            self._refuse("disk", str(error), topic, cdr)
            self._fail(error)
            return
        held, self._held = self._held, {}
        for latched, state in held.items():
            self._write(writer, latched, self._topics[latched][0], state, log_time_ns)
        self._write(writer, topic, type_name, cdr, log_time_ns)

    def _write(self, writer: BagWriter, topic: str, type_name: str, cdr: bytes, log_time_ns: int) -> None:
        lost = writer.lost
        try:
            writer.write_raw(topic, type_name, cdr, log_time_ns)
        except RecordingError as error:
            if not isinstance(error.__cause__, OSError):
                raise
            self._lose(error, writer.lost - lost)
        self._account()

    def flush(self) -> None:
        """Once a second: hand what waits to the operating system, look at the disk, say how it is."""
        low = self._low()
        if self._writer is not None:
            self._try(self._writer.flush)
        if low:
            self._health.trouble("disk_low", self._why_low())
        elif self._failed:
            self._health.trouble("disk", self._failed)
        self._health.gauge("disk_free_bytes", self._floor.free)
        self._health.gauge("file_bytes", 0 if self._writer is None else self._writer.file_bytes)

    def close(self) -> bool:
        """Finish the bag; whether it is whole."""
        for topic in self._held:
            self._health.drop("disk", f"the last message of {topic} came while recording was stopped")
        return self._writer is None or self._try(self._writer.close)

    def _open(self) -> BagWriter:
        folder = self._ring.new_folder()
        self._writer = BagWriter(
            folder, split=self._limits.split, library=self._ring.library, before_file=self._make_room
        )
        for topic, (type_name, latched) in self._topics.items():
            self._writer.add_topic(topic, type_name, latched)
        return self._writer

    def _make_room(self) -> None:
        for _ in self._ring.make_room(self._limits.split.most_bytes):
            self._health.note("files_removed")
        self._health.gauge("recorded_bytes", self._ring.total())

    def _refuse(self, cause: str, why: str, topic: str, cdr: bytes) -> None:
        """The last message of a latched topic is state, which comes but once: it waits until recording goes on."""
        latched = topic in self._topics and self._topics[topic][1]
        if not latched or topic in self._held:
            self._health.drop(cause, why)
        if latched:
            self._held[topic] = cdr

    def _low(self) -> bool:
        """Looks at the disk; a recording that stops ends its file, so that it can be read meanwhile."""
        before, low = self._floor.low, self._floor.look()
        if low and not before:
            self._tell(f"recording stopped: {self._why_low()}")
            if self._writer is not None:
                self._try(self._writer.end_file)
        elif before and not low:
            self._tell(f"recording continues: {self._floor.free / 1e6:.0f} MB are free")
        return low

    def _why_low(self) -> str:
        free, least, again = (f"{n / 1e6:.0f} MB" for n in (self._floor.free, self._floor.floor, self._floor.again))
        return (
            f"{free} are free on the disk of {self._path}, but recording needs {least}; delete files (recording "
            f"continues from {again} on), or lower min_free_bytes"
        )

    def _try(self, act: Callable[[], None]) -> bool:
        """False where the disk has failed."""
        writer = self._writer
        assert writer is not None  # nosec B101 # tells the type checker what holds
        lost = writer.lost
        try:
            act()
        except RecordingError as error:
            self._lose(error, writer.lost - lost)
            return False
        finally:
            self._account()
        return True

    def _lose(self, error: RecordingError, count: int) -> None:
        if count:
            self._health.drop("disk", str(error), count)
        self._fail(error)

    def _fail(self, error: RecordingError) -> None:
        if not self._failed:
            self._tell(str(error))
        self._failed = str(error)
        self._health.trouble("disk", self._failed)
        self._retry_at = time.monotonic() + self._backoff.failed()

    def _account(self) -> None:
        if self._writer is None:
            return
        new = self._writer.on_disk - self._told
        for topic, count in new.items():
            for _ in range(count):
                self._health.published(topic)
        self._told = self._writer.on_disk.copy()
        if new and self._failed:
            self._failed = ""
            self._backoff.succeeded()
            self._tell("recording goes on")


QUEUE_BYTES = 256 << 20
"""Bytes of messages that may wait for the disk before more are dropped and counted. DDS holds as much besides where
messages are large, and all of it shall stay below a gigabyte."""
QUEUE_MESSAGES = 100_000
"""Messages likewise, however small they are: each takes some 450 bytes of Python's besides its own."""
CLOSE_S = 5.0
"""For which a recorder that is told to stop goes on writing what waits."""

_Work = tuple[Callable[[], None], int | None]
"""What is to be done, and the bytes of the message if it stores one."""


class RecordingThread:
    """Hands messages to a recording in the order in which they come, from any threads; the only one that writes."""

    def __init__(
        self,
        recording: BoundedRecording,
        health: Health,
        tell: Callable[[str], None],
        most_bytes: int = QUEUE_BYTES,
        most_messages: int = QUEUE_MESSAGES,
    ) -> None:
        """`tell`: a line of each error. Runs from now on."""
        self._recording, self._health, self._tell = recording, health, tell
        self._most_bytes, self._most_messages = most_bytes, most_messages
        self._queue: queue.Queue[_Work | None] = queue.Queue()
        self._lock = threading.Lock()
        self._bytes = self._messages = 0
        self._flushing = False
        self._stop_at = math.inf
        self._thread = threading.Thread(target=self._write, name="recorder disk", daemon=True)
        self._thread.start()

    def add_topic(self, topic: str, type_name: str, latched: bool) -> None:
        self._queue.put((partial(self._recording.add_topic, topic, type_name, latched), None))

    def flush(self) -> None:
        """Hand what is written to the operating system; nothing more where that waits already."""
        if not self._flushing:
            self._flushing = True
            self._queue.put((self._flush, None))

    def take(self, topic: str, type_name: str, cdr: bytes, log_time_ns: int) -> None:
        """Write a message; where too many wait, or too large ones, it is dropped and counted as `overload`."""
        with self._lock:
            if self._bytes + len(cdr) > self._most_bytes or self._messages >= self._most_messages:
                waiting = f"{self._messages} messages ({self._bytes >> 20} MB) are queued for the disk"
                self._health.drop("overload", f"{waiting}; record fewer topics")
                return
            self._bytes += len(cdr)
            self._messages += 1
        self._queue.put((partial(self._store, topic, type_name, cdr, log_time_ns), len(cdr)))

    def close(self) -> bool:
        """Write what waits, for `CLOSE_S` at most, and finish the bag; whether it is whole."""
        self._stop_at = time.monotonic() + CLOSE_S
        self._queue.put(None)
        self._thread.join()
        return self._recording.close()

    def _write(self) -> None:
        activity = HEARTBEAT.activity("recorder disk")
        while (item := self._queue.get()) is not None:
            work, size = item
            try:
                with activity.turn("write"):
                    work()
            except LtmError as error:
                self._health.drop(cause_of(error), str(error))
                self._tell(str(error))
            except BaseException:
                # A bug: a recorder that does not record shall not seem to; the graph starts another.
                sys.excepthook(*sys.exc_info())
                os._exit(1)
            if size is not None:
                self._done(size)

    def _done(self, size: int) -> None:
        with self._lock:
            self._bytes -= size
            self._messages -= 1
            self._health.gauge("queue_bytes", self._bytes)
            self._health.gauge("queue_messages", self._messages)

    def _flush(self) -> None:
        self._flushing = False
        self._recording.flush()

    def _store(self, topic: str, type_name: str, cdr: bytes, log_time_ns: int) -> None:
        if time.monotonic() > self._stop_at:
            self._health.drop("stopped", f"the disk took more than {CLOSE_S:.0f} s for the queued messages at the end")
            return
        self._recording.write(topic, type_name, cdr, log_time_ns)
