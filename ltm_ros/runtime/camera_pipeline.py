"""Run the jobs of each camera in a process that all cameras share, with fair turns."""

from __future__ import annotations

import os
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Protocol

from ltm_core.base.errors import LtmError
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.health import cause_of
from ltm_ros.runtime.heartbeat import Activity, Heartbeat
from ltm_ros.runtime.pipeline import Job, Pipeline
from ltm_ros.runtime.retry import Backoff
from ltm_ros.runtime.stamp_join import data_bytes


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


INBOX = 1000
"""Messages that wait for a camera's next turn at most: some seconds of images, poses and calibrations."""
INBOX_BYTES = 128 << 20
"""Of data, that wait at most; a message alone always has room."""
CRASHED = "crash"
"""Why frames are counted as dropped whose job a bug has ended."""


class CameraPipeline:
    """What other processes send waits for the camera's turn (`FrameScheduler`). In its turn first all of that is
    handled, so that of several frames the newest is known; then one is let in, and runs through all jobs.

    What is wrong with a message is counted by the job that refuses it, as in a process of its own. After a bug the
    frame is dropped everywhere and counted (`CRASHED`), and the job's handler is made anew; where that fails, too, the
    job is left out, and tried again now and then.

    Args:
        say: takes a job's name and what shall be logged of it.
    """

    def __init__(self, say: Callable[[str, str], None]) -> None:
        self.pipeline = Pipeline(self._run)
        self._say = say
        self._lock = threading.Lock()
        self._inbox: deque[tuple[Job, Topic, Any]] = deque()
        self._inbox_bytes = 0
        self._taking = True
        """Whether handlers get further messages before they are idle."""
        self._closing = False
        self._activity = Activity("start")
        self._broken: dict[str, Backoff] = {}
        """Jobs whose handlers could not be made anew."""
        self._waited = 0.0
        """Seconds that the handlers have not been told of."""

    @property
    def more_waits(self) -> bool:
        return self._taking

    @property
    def waiting(self) -> int:
        """Messages in the inbox."""
        return len(self._inbox)

    def offer(self, job: Job, topic: Topic, message: Any) -> None:
        """Have a message wait for the next turn, from any thread. Raises queue.Full where there is no room."""
        size = data_bytes(message)
        with self._lock:
            full = len(self._inbox) >= INBOX or (self._inbox_bytes and self._inbox_bytes + size > INBOX_BYTES)
            if full:
                raise queue.Full
            self._inbox.append((job, topic, message))
            self._inbox_bytes += size

    def tick(self, waited: float) -> None:
        """So many seconds have passed; the handlers are told in the next turn."""
        with self._lock:
            self._waited += waited

    def turn(self, activity: Activity) -> bool:
        """As `TurnTaker`."""
        self._activity = activity
        self._take_inbox()
        self._tell_time()
        if self._closing:
            return False
        self._taking = False
        self.pipeline.idle()
        self._taking = True
        let_in = not self.pipeline.empty
        self.pipeline.drain()
        return let_in

    def stop_admitting(self) -> None:
        """No frame is let in any more."""
        self._closing = True

    def finish(self) -> None:
        """Handle what waits, then tell all handlers that no more will come."""
        self._activity = Activity("end")
        self._take_inbox()
        self.pipeline.finish()

    def _take_inbox(self) -> None:
        with self._lock:
            taken, self._inbox, self._inbox_bytes = self._inbox, deque(), 0
        for job, topic, message in taken:
            self.pipeline.deliver(job, topic, message)
            self.pipeline.drain()

    def _tell_time(self) -> None:
        with self._lock:
            waited, self._waited = self._waited, 0.0
        if not waited:
            return
        for name, pace in list(self._broken.items()):
            pace.passed(waited)
            if pace.due:
                self._renew(self.pipeline.jobs[name], pace)
        for job in self.pipeline.jobs.values():
            self._run(job, lambda j=job: j.handler.tick(waited), "", None)  # type: ignore[misc]
            self.pipeline.drain()

    def _run(self, job: Job, work: Callable[[], None], topic: str, message: Any) -> None:
        if job.name in self._broken:
            if message is not None:
                job.health.drop("down", f"{job.name} could not be started again after a bug; see the log")
                self._drop_frame(job, message)
            return
        began, used, results = time.perf_counter(), time.thread_time(), job.health.results
        self._activity.begin(f"{job.name}: {type(message).__name__ if topic else 'tick'}")
        try:
            work()
        except LtmError as error:
            job.health.drop(cause_of(error), str(error))
            self._say(job.name, str(error))
        except Exception as error:
            self._crashed(job, message, error)
        finally:
            self._activity.end()
        job.health.used(time.thread_time() - used)
        # A message that only waits for others to join it tells nothing of the work on a frame.
        if job.health.results > results:
            job.health.worked(time.perf_counter() - began)

    def _crashed(self, job: Job, message: Any, error: Exception) -> None:
        sys.excepthook(*sys.exc_info())
        job.health.drop(CRASHED, f"{error!r}: a bug; the frame is dropped and {job.name} started anew; see the log")
        self._drop_frame(job, message)
        self._renew(job, Backoff())

    def _drop_frame(self, job: Job, message: Any) -> None:
        """No job shall wait for what `job` would have made of it."""
        self.pipeline.clear()
        if hasattr(message, "header"):
            stamp = stamp_of(message)
            for other in self.pipeline.jobs.values():
                if other is not job and other.name not in self._broken:
                    other.handler.discard(stamp)

    def _renew(self, job: Job, pace: Backoff) -> None:
        try:
            job.renew()
            job.handler.start()
        except Exception:
            sys.excepthook(*sys.exc_info())
            pace.failed()
            self._broken[job.name] = pace
        else:
            self._broken.pop(job.name, None)
            self.pipeline.remind(job)
