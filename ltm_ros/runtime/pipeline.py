"""Connect handlers of one process that pass messages directly, without transport."""

from collections import defaultdict, deque
from collections.abc import Callable
from graphlib import TopologicalSorter
from typing import Any

from ltm_ros.runtime.handler import Handler, Topic
from ltm_ros.runtime.health import Health


class Job:
    """One handler of a pipeline. `name`: the node's full name; `namespace`: absolute."""

    def __init__(self, name: str, namespace: str, health: Health, handler: Handler[Any]) -> None:
        self.name, self.namespace, self.health, self.handler = name, namespace, health, handler
        self.callbacks = dict(handler.subscriptions)


Run = Callable[[Job, Callable[[], None], str, Any], None]
"""Runs a job on a message of a topic ("", None: none), and handles its errors."""


class Pipeline:
    """Jobs that process each other's messages, one at a time, in the order of publication; for one thread at a time."""

    def __init__(self, run: Run) -> None:
        self._run = run
        self.jobs: dict[str, Job] = {}
        """Jobs by full name, in the order in which they were added."""
        self._listeners: defaultdict[str, list[tuple[Job, Topic]]] = defaultdict(list)
        self._sources: defaultdict[str, set[str]] = defaultdict(set)
        self._waiting: deque[tuple[str, Any]] = deque()
        self._cleared = False
        """Whether the current message is withheld from further jobs."""

    def add(self, job: Job) -> None:
        self.jobs[job.name] = job
        for topic in job.handler.publications:
            self._sources[topic.under(job.namespace)].add(job.name)
        for topic in job.callbacks:
            self._listeners[topic.under(job.namespace)].append((job, topic))

    def start(self) -> None:
        """Start every handler."""
        for job in self.jobs.values():
            job.handler.start()

    def made_here(self, topic: str) -> bool:
        """Return whether a job publishes on this absolute topic."""
        return topic in self._sources

    def listened(self, topic: str) -> bool:
        """Return whether a job subscribes to it."""
        return topic in self._listeners

    def publish(self, topic: str, message: Any) -> None:
        """Queue a message for delivery by `drain`."""
        self._waiting.append((topic, message))

    def deliver(self, job: Job, topic: Topic, message: Any) -> None:
        """Give a message to one job at once."""
        self._run(job, lambda: job.callbacks[topic](message), topic.under(job.namespace), message)

    def drain(self) -> bool:
        """Deliver all published messages, and those that follow from them; return whether there were any."""
        any_waiting = bool(self._waiting)
        while self._waiting:
            topic, message = self._waiting.popleft()
            self._cleared = False
            for job, own in self._listeners.get(topic, ()):
                if own.counted:
                    job.health.received(own.counted_name)
                self.deliver(job, own, message)
                if self._cleared:
                    break
        return any_waiting

    def idle(self) -> None:
        """Call `idle` of every handler."""
        for job in self.jobs.values():
            self._run(job, job.handler.idle, "", None)

    def settle(self) -> None:
        """Deliver all published messages and those that follow from them, including `idle`."""
        while self._waiting:
            self.drain()
            self.idle()

    def end_of_day(self) -> None:
        """Call `end_of_day` of every handler and deliver the results."""
        for job in self.jobs.values():
            self._run(job, job.handler.end_of_day, "", None)
        self.settle()

    def clear(self) -> None:
        """Drop all undelivered messages, also of the current one."""
        self._waiting.clear()
        self._cleared = True

    def finish(self) -> None:
        """Finish every handler after those that it depends on, and deliver the results."""
        upstream: dict[str, set[str]] = {name: set() for name in self.jobs}
        for topic, listeners in self._listeners.items():
            for job, own in listeners:
                # A latched message is a state, which may be fed back to the source of its frames.
                if not own.latched:
                    upstream[job.name] |= self._sources.get(topic, set())
        for name in TopologicalSorter(upstream).static_order():
            job = self.jobs[name]
            self._run(job, job.handler.finish, "", None)
            self.settle()
