"""Record within limits of disk space: a ring of files, written by a separate thread."""

import errno
import math
import os
import queue
import shutil
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from operator import methodcaller
from pathlib import Path
from typing import Self

from ltm_core.base.errors import LtmError, RecordingError
from ltm_core.storage.disk_io import folder_that_exists, free_bytes
from ltm_msgs_py.bag.ring import RecordingRing
from ltm_msgs_py.bag.writer import BagWriter, Split
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.heartbeat import HEARTBEAT
from ltm_ros.runtime.retry import Backoff

RING_BYTES, RING_SHARE = 16_000_000_000, 0.5
"""Default maximum of all recordings: the smaller of bytes and share of the disk."""
FLOOR_BYTES, FLOOR_SHARE = 2_000_000_000, 0.1
"""Default free space that a recording leaves, likewise."""
RETRY_S, LONGEST_RETRY_S = 1.0, 15.0
"""First and longest pause after the disk has failed."""


@dataclass(frozen=True)
class RecordingLimits:
    """`most_bytes`: of all recordings that are not kept, None: unlimited. `floor`: bytes that stay free."""

    most_bytes: int | None
    floor: int
    split: Split

    @property
    def again(self) -> int:
        """Return the free bytes from which a stopped recording continues: more than the floor, because it must not stop
        and start with every file that other programs remove."""
        return self.floor + self.floor // 10

    @classmethod
    def of(cls, path: Path, max_bytes: int, min_free_bytes: int, file_bytes: int, file_seconds: float) -> Self:
        """Return the limits of a configuration on the disk of `path`. Raises RecordingError without such a disk."""
        try:
            disk = shutil.disk_usage(folder_that_exists(path)).total
        except OSError as error:
            raise RecordingError(f"cannot read the disk usage of {path}: {error}") from error
        most = min(RING_BYTES, int(RING_SHARE * disk)) if max_bytes < 0 else max_bytes or None
        floor = min(FLOOR_BYTES, int(FLOOR_SHARE * disk)) if min_free_bytes < 0 else min_free_bytes
        size = file_bytes if most is None else max(1, min(file_bytes, most // 4))
        return cls(most, floor, Split(size, int(file_seconds * 1e9)))


class BoundedRecording:
    """Writes messages into bags; for one thread. Disk errors are reported to `health`, not raised.

    Messages count as published when the operating system has them, else as dropped by `disk` or `disk_low`."""

    def __init__(
        self, path: Path, recorder: str, limits: RecordingLimits, health: Health, tell: Callable[[str], None]
    ) -> None:
        """Open the recording. `tell`: gets one line each time that recording stops or continues.

        Raises RecordingError if no bag can be made for another reason than a full disk."""
        self._limits, self._health, self._tell = limits, health, tell
        self._ring = RecordingRing(path, recorder, limits.most_bytes)
        self._path = path
        self._low = False
        self._free_bytes = 0
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
        """Announce a topic. Raises RecordingError for an unknown type."""
        self._accounted(lambda writer: writer.add_topic(topic, type_name, latched))
        self._topics[topic] = type_name, latched

    def write(self, topic: str, type_name: str, cdr: bytes, log_time_ns: int) -> None:
        """Write a message. Raises RecordingError for an invalid one."""
        if self._disk_is_low():
            self._refuse("disk_low", self._why_low(), topic, cdr)
            return
        if time.monotonic() < self._retry_at:
            self._refuse("disk", self._failed, topic, cdr)
            return
        if self._writer is None:
            try:
                self._open()
            except RecordingError as error:
                self._refuse("disk", str(error), topic, cdr)
                self._fail(error)
                return
        held, self._held = self._held, {}
        due = [(name, self._topics[name][0], message) for name, message in held.items()]
        for one in [*due, (topic, type_name, cdr)]:
            self._accounted(methodcaller("write_raw", *one, log_time_ns))

    def flush(self) -> None:
        """Pass written data to the operating system, check the disk, and report its state; call it once a second."""
        self._disk_is_low()
        self._accounted(BagWriter.flush)
        if self._low:
            self._health.trouble("disk_low", self._why_low())
        elif self._failed:
            self._health.trouble("disk", self._failed)
        self._health.gauge("disk_free_bytes", self._free_bytes)
        self._health.gauge("file_bytes", 0 if self._writer is None else self._writer.file_bytes)

    def close(self) -> bool:
        """Finish the bag; return whether it is complete."""
        for topic in self._held:
            self._health.drop("disk", f"the last message of {topic} came while recording was stopped")
        return self._accounted(BagWriter.close)

    def _open(self) -> None:
        folder, split, library = self._ring.new_folder(), self._limits.split, self._ring.library
        self._writer = BagWriter(folder, split=split, library=library, before_file=self._make_room)
        for topic, (type_name, latched) in self._topics.items():
            self._writer.add_topic(topic, type_name, latched)

    def _make_room(self) -> None:
        for _ in self._ring.make_room(self._limits.split.most_bytes):
            self._health.note("files_removed")
        self._health.gauge("recorded_bytes", sum(self._ring.sizes().values()))

    def _refuse(self, cause: str, why: str, topic: str, cdr: bytes) -> None:
        """Drop a message; the last one of a latched topic waits for a recording, because it is not repeated."""
        latched = topic in self._topics and self._topics[topic][1]
        if not latched or topic in self._held:
            self._health.drop(cause, why)
        if latched:
            self._held[topic] = cdr

    def _disk_is_low(self) -> bool:
        """Check the disk; when recording stops, the file is finished, so that it can be read."""
        try:
            self._free_bytes = free_bytes(self._path)
        except OSError:  # gone or read-only: writing will report it
            return self._low
        before, self._low = self._low, self._free_bytes < (self._limits.again if self._low else self._limits.floor)
        if self._low and not before:
            self._tell(f"recording stopped: {self._why_low()}")
            self._accounted(BagWriter.end_file)
        elif before and not self._low:
            self._tell(f"recording continues: {self._free_bytes / 1e6:.0f} MB are free")
        return self._low

    def _why_low(self) -> str:
        numbers = self._free_bytes, self._limits.floor, self._limits.again
        free, least, again = (f"{number / 1e6:.0f} MB" for number in numbers)
        return (
            f"{free} are free on the disk of {self._path}, but recording needs {least}; delete files (recording "
            f"continues from {again} on), or lower min_free_bytes"
        )

    def _accounted(self, work: Callable[[BagWriter], None]) -> bool:
        """Call `work` with the writer, if any, and count what it saves and loses. Report a disk error and return False.
        Raises RecordingError for another error."""
        if (writer := self._writer) is None:
            return True
        lost, done = writer.lost, True
        try:
            work(writer)
        except RecordingError as error:
            if not isinstance(error.__cause__, OSError):
                raise
            if writer.lost > lost:
                self._health.drop("disk", str(error), writer.lost - lost)
            self._fail(error)
            done = False
        new = writer.on_disk - self._told
        for topic in new.elements():
            self._health.published(topic)
        self._told += new
        if new and self._failed:
            self._failed = ""
            self._backoff.succeeded()
            self._tell("recording continues")
        return done

    def _fail(self, error: RecordingError) -> None:
        if not self._failed:
            self._tell(str(error))
        self._failed = str(error)
        self._health.trouble("disk", self._failed)
        self._retry_at = time.monotonic() + self._backoff.failed()


QUEUE_BYTES = 256 << 20
"""Maximum bytes of queued messages; more are dropped. DDS may hold as much, and the total must stay below 1 GB."""
QUEUE_MESSAGES = 100_000
"""Maximum number of queued messages: each takes some 450 bytes besides its own."""
CLOSE_S = 5.0
"""Seconds for which a stopping recorder writes its queue."""


class RecordingThread:
    """Passes messages from any threads to a recording in order; only this thread writes."""

    def __init__(self, recording: BoundedRecording, health: Health, tell: Callable[[str], None]) -> None:
        """Start the thread. `tell`: gets a line of each error."""
        self._recording, self._health, self._tell = recording, health, tell
        self._queue: queue.Queue[Callable[[], None] | None] = queue.Queue()
        self._lock = threading.Lock()
        self._bytes = self._messages = 0
        self._flushing = False
        self._stop_at = math.inf
        self._thread = threading.Thread(target=self._work, name="recorder disk", daemon=True)
        self._thread.start()

    def add_topic(self, topic: str, type_name: str, latched: bool) -> None:
        self._queue.put(partial(self._recording.add_topic, topic, type_name, latched))

    def flush(self) -> None:
        """Pass written data to the operating system, unless that is queued already."""
        if not self._flushing:
            self._flushing = True
            self._queue.put(self._flush)

    def take(self, topic: str, type_name: str, cdr: bytes, log_time_ns: int) -> None:
        """Queue a message; if the queue is full, it is dropped and counted as `overload`."""
        with self._lock:
            if self._bytes + len(cdr) > QUEUE_BYTES or self._messages >= QUEUE_MESSAGES:
                waiting = f"{self._messages} messages ({self._bytes >> 20} MB) are queued for the disk"
                self._health.drop("overload", f"{waiting}; record fewer topics")
                return
            self._bytes += len(cdr)
            self._messages += 1
        self._queue.put(partial(self._store, topic, type_name, cdr, log_time_ns))

    def close(self) -> bool:
        """Write the queue, for `CLOSE_S` at most, and finish the bag; return whether it is complete."""
        self._stop_at = time.monotonic() + CLOSE_S
        self._queue.put(None)
        self._thread.join()
        return self._recording.close()

    def _work(self) -> None:
        activity = HEARTBEAT.activity("recorder disk")
        while (work := self._queue.get()) is not None:
            try:
                with activity.turn("write"):
                    work()
            except LtmError as error:
                self._health.drop(cause_of(error), str(error))
                self._tell(str(error))
            except BaseException:
                # An internal error: a recorder that does not record must not look healthy; the graph restarts it.
                sys.excepthook(*sys.exc_info())
                os._exit(1)

    def _flush(self) -> None:
        self._flushing = False
        self._recording.flush()

    def _store(self, topic: str, type_name: str, cdr: bytes, log_time_ns: int) -> None:
        try:
            if time.monotonic() <= self._stop_at:
                self._recording.write(topic, type_name, cdr, log_time_ns)
            else:
                why = f"the disk took more than {CLOSE_S:.0f} s for the queued messages at the end"
                self._health.drop("stopped", why)
        finally:
            with self._lock:
                self._bytes -= len(cdr)
                self._messages -= 1
                self._health.gauge("queue_bytes", self._bytes)
                self._health.gauge("queue_messages", self._messages)
