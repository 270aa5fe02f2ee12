"""The thread of a recorder that waits for the disk, and what waits for that thread: so much and no more."""

from __future__ import annotations

import math
import os
import queue
import sys
import threading
import time
from collections.abc import Callable
from functools import partial

from ltm_core.base.errors import LtmError
from ltm_ros.recordings.bounded_recording import BoundedRecording
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.heartbeat import HEARTBEAT

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
                waiting = f"{self._messages} messages ({self._bytes >> 20} MB) wait for the disk"
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
            self._health.drop("stopped", f"the disk took more than {CLOSE_S:.0f} s for what waited at the end")
            return
        self._recording.write(topic, type_name, cdr, log_time_ns)
