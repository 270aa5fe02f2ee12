"""Report once a second to the runner's watchdog what this process does, and which of its nodes are ready.

A separate thread writes a line of JSON into a pipe, so it needs no DDS and works while a node loads and compiles. The
thread itself shows that the process is scheduled and the interpreter's lock is free; the activities show that work
progresses. Uses only the standard library."""

import contextlib
import json
import os
import select
import threading
import time
from collections.abc import Callable, Iterable, Iterator

PERIOD_S = 1.0

Beat = list[tuple[float, bool, str]]
"""Activity of a process: seconds, whether it may take long, and its name."""


class Activity:
    """An executor or worker thread, which works in turns. While it waits, it has no turn."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.turns = 0
        self.what: str | None = None
        """What it does in this turn; None: nothing."""
        self.slow = False
        """Whether this turn may take long."""

    def begin(self, what: str, slow: bool = False) -> None:
        self.turns += 1
        self.slow = slow
        self.what = what

    def end(self) -> None:
        self.what = None

    @contextlib.contextmanager
    def turn(self, what: str, slow: bool = False) -> Iterator[None]:
        self.begin(what, slow)
        try:
            yield
        finally:
            self.end()


class Heartbeat:
    """The activities of a process, and the thread that reports them."""

    def __init__(self) -> None:
        self._activities: list[Activity] = []
        self._ages: dict[Activity, tuple[int, float]] = {}
        self._ready: dict[str, None] = {}

    def ready(self, nodes: Iterable[str]) -> None:
        """Report from now on that these nodes, by full name, have sent a diagnostic."""
        self._ready |= dict.fromkeys(nodes)

    def activity(self, name: str) -> Activity:
        """Return a new activity, watched from its first turn on."""
        made = Activity(name)
        self._activities.append(made)
        return made

    def look(self, elapsed_s: float) -> Beat:
        """Return the activities, `elapsed_s` after the last call; a turn's age counts from the first call
        that saw it."""
        beat: Beat = []
        for activity in list(self._activities):
            turn, what = activity.turns, activity.what
            former, age = self._ages.get(activity, (0, 0.0))
            age = age + elapsed_s if turn == former else 0.0
            self._ages[activity] = turn, age
            if what is not None:
                beat.append((round(age, 1), activity.slow, f"{activity.name}: {what}"))
        return beat

    def start(self, descriptor: int, reader_gone: Callable[[], None]) -> None:
        """Start a thread that writes to the pipe, and at the end calls `reader_gone`."""
        os.set_blocking(descriptor, False)
        threading.Thread(target=self._tell, args=(descriptor, reader_gone), name="heartbeat", daemon=True).start()

    def _tell(self, descriptor: int, reader_gone: Callable[[], None]) -> None:
        poll = select.poll()
        poll.register(descriptor, 0)  # only errors: the reader has gone
        last, wait_s, rest = time.monotonic(), 0.0, b""
        while not poll.poll(wait_s * 1000):
            wait_s, now = PERIOD_S, time.monotonic()
            # At most the possible duration: this process or the machine may have been paused.
            elapsed_s, last = min(now - last, 2 * PERIOD_S), now
            told = {"activities": self.look(elapsed_s), "ready": list(self._ready.copy())}
            # The rest of an incomplete line must be sent first, or the next line would be invalid.
            lines = rest or f"{json.dumps(told)}\n".encode()
            try:
                rest = lines[os.write(descriptor, lines) :]
            except BlockingIOError:
                continue  # the runner is paused; it will need only the newest
            except BrokenPipeError:
                break
        reader_gone()


HEARTBEAT = Heartbeat()
"""Heartbeat of this process."""
STARTING = HEARTBEAT.activity("start")
