"""Shares a process's threads fairly among cameras: the one that has waited longest is worked on next."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import deque
from typing import Protocol

from ltm_ros.runtime.heartbeat import Activity, Heartbeat


class TurnTaker(Protocol):
    """Something that is worked on turn by turn, by one thread at a time: a camera."""

    def turn(self, activity: Activity) -> bool:
        """Do what there is to do, one frame at most; whether there may be more. `activity`: the thread's own, to tell
        what it is at."""
        ...


class FrameScheduler:
    """Gives turns to those that were woken, in that order, on `workers` threads.

    Who was woken while it had its turn, or says that there is more, queues up behind all others that wait: under
    overload all get equally many turns. What a turn raises is a bug of the process: it ends, with its traceback.
    """

    def __init__(self, workers: int, heartbeat: Heartbeat) -> None:
        self._changed = threading.Condition()
        self._queue: deque[TurnTaker] = deque()
        self._queued: set[TurnTaker] = set()
        self._at_work: dict[TurnTaker, bool] = {}
        """Those that have a turn now, and whether they were woken meanwhile."""
        self._closing = False
        self._threads = [
            threading.Thread(
                target=self._work, args=(heartbeat.activity(f"worker {n}"),), name=f"worker {n}", daemon=True
            )
            for n in range(1, workers + 1)
        ]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def wake(self, taker: TurnTaker) -> None:
        """There is something to do for `taker`; from any thread."""
        with self._changed:
            if taker in self._at_work:
                self._at_work[taker] = True
            else:
                self._enqueue(taker)

    def close(self, patience_s: float) -> bool:
        """Let the threads end when nobody waits for a turn any more; whether they have, in so many seconds."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        deadline = time.monotonic() + patience_s
        for thread in self._threads:
            thread.join(max(0.0, deadline - time.monotonic()))
        return not any(thread.is_alive() for thread in self._threads)

    def _enqueue(self, taker: TurnTaker) -> None:
        if taker not in self._queued:
            self._queued.add(taker)
            self._queue.append(taker)
            self._changed.notify()

    def _next(self) -> TurnTaker | None:
        with self._changed:
            while not self._queue:
                if self._closing:
                    return None
                self._changed.wait()
            taker = self._queue.popleft()
            self._queued.discard(taker)
            self._at_work[taker] = False
            return taker

    def _work(self, activity: Activity) -> None:
        while (taker := self._next()) is not None:
            try:
                more = taker.turn(activity)
            except BaseException:
                sys.excepthook(*sys.exc_info())
                os._exit(1)
            with self._changed:
                if self._at_work.pop(taker) or more:
                    self._enqueue(taker)
