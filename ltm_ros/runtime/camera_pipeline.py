"""Run the jobs of all cameras in a shared process, with fair turns."""

import os
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

from ltm_core.base.errors import LtmError
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.health import cause_of
from ltm_ros.runtime.heartbeat import Activity, Heartbeat
from ltm_ros.runtime.pipeline import Job, Pipeline
from ltm_ros.runtime.stamp_join import data_bytes


class FrameScheduler:
    """Gives turns to woken cameras, in that order, on `workers` threads.

    A camera that was woken during its turn, or has more to do, goes to the end of the queue: under overload all get
    equally many turns. An exception from a turn is a bug and ends the process with its traceback."""

    def __init__(self, workers: int, heartbeat: Heartbeat) -> None:
        self._changed = threading.Condition()
        self._queue: dict[CameraPipeline, None] = {}
        self._at_work: dict[CameraPipeline, bool] = {}
        """Cameras that have a turn now, and whether they were woken meanwhile."""
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

    def wake(self, camera: "CameraPipeline") -> None:
        """Schedule `camera`; thread-safe."""
        with self._changed:
            if camera in self._at_work:
                self._at_work[camera] = True
            else:
                self._enqueue(camera)

    def close(self, patience_s: float) -> bool:
        """Let the threads end when the queue is empty; return whether they have within the time limit."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        deadline = time.monotonic() + patience_s
        for thread in self._threads:
            thread.join(max(0.0, deadline - time.monotonic()))
        return not any(thread.is_alive() for thread in self._threads)

    def _enqueue(self, camera: "CameraPipeline") -> None:
        if camera not in self._queue:
            self._queue[camera] = None
            self._changed.notify()

    def _next(self) -> "CameraPipeline | None":
        with self._changed:
            while not self._queue:
                if self._closing:
                    return None
                self._changed.wait()
            camera = next(iter(self._queue))
            del self._queue[camera]
            self._at_work[camera] = False
            return camera

    def _work(self, activity: Activity) -> None:
        while (camera := self._next()) is not None:
            try:
                more = camera.turn(activity)
            except BaseException:
                sys.excepthook(*sys.exc_info())
                os._exit(1)
            with self._changed:
                if self._at_work.pop(camera) or more:
                    self._enqueue(camera)


INBOX = 1000
"""Maximum number of messages that wait for a camera's next turn: some seconds of images, poses and calibrations."""
INBOX_BYTES = 128 << 20
"""Maximum bytes of waiting data; a single message is always accepted."""
CRASHED = "crash"
"""Cause under which frames are dropped whose job has failed with a bug."""


class CameraPipeline:
    """Messages from other processes wait for the camera's turn (`FrameScheduler`). A turn first handles all of them, so
    that the newest frame is known; then one frame is admitted and runs through all jobs.

    The job that rejects a message counts it. After a bug, the frame is dropped everywhere and counted (`CRASHED`); the
    other frames and cameras continue.

    Args: say: takes a job's name and a line for its log."""

    def __init__(self, say: Callable[[str, str], None]) -> None:
        self.pipeline = Pipeline(self._run)
        self._say = say
        self._lock = threading.Lock()
        self._inbox: deque[tuple[Job, Topic, Any]] = deque()
        self._inbox_bytes = 0
        self.more_waits = True
        """Whether handlers get further messages before `idle`."""
        self.closing = False
        """Whether no more frames are admitted."""
        self._activity = Activity("start")
        self._waited = 0.0
        """Seconds not yet passed on to the handlers."""

    @property
    def waiting(self) -> int:
        """Return the number of messages in the inbox and in work."""
        return len(self._inbox) + (not self.more_waits)

    def offer(self, job: Job, topic: Topic, message: Any) -> None:
        """Queue a message for the next turn; thread-safe. Raises queue.Full without room."""
        size = data_bytes(message)
        with self._lock:
            full = len(self._inbox) >= INBOX or (self._inbox_bytes and self._inbox_bytes + size > INBOX_BYTES)
            if full:
                raise queue.Full
            self._inbox.append((job, topic, message))
            self._inbox_bytes += size

    def tick(self, waited: float) -> None:
        """Advance time; the handlers get it in the next turn."""
        with self._lock:
            self._waited += waited

    def turn(self, activity: Activity) -> bool:
        """Process one frame at most; return whether there may be more. `activity`: of the thread, for the heartbeat."""
        self._activity = activity
        self._take_inbox()
        with self._lock:
            waited, self._waited = self._waited, 0.0
        for job in self.pipeline.jobs.values() if waited else ():
            self._run(job, partial(job.handler.tick, waited), "", None)
            self.pipeline.drain()
        if self.closing:
            return False
        self.more_waits = False
        self.pipeline.idle()
        let_in = self.pipeline.drain()
        self.more_waits = True
        return let_in

    def finish(self) -> None:
        """Handle the queued messages, then tell all handlers that no more come."""
        self._activity = Activity("end")
        self._take_inbox()
        self.pipeline.finish()

    def _take_inbox(self) -> None:
        with self._lock:
            taken, self._inbox, self._inbox_bytes = self._inbox, deque(), 0
        for job, topic, message in taken:
            self.pipeline.deliver(job, topic, message)
            self.pipeline.drain()

    def _run(self, job: Job, work: Callable[[], None], topic: str, message: Any) -> None:
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
        # A message that only waits for others to join it takes no processing time.
        if job.health.results > results:
            job.health.worked(time.perf_counter() - began)

    def _crashed(self, job: Job, message: Any, error: Exception) -> None:
        sys.excepthook(*sys.exc_info())
        job.health.drop(CRASHED, f"{error!r}: internal error; the frame is dropped; see the log")
        self.pipeline.clear()
        if hasattr(message, "header"):
            for other in self.pipeline.jobs.values():  # so that none waits for the results of `job`
                other.handler.discard(stamp_of(message))
