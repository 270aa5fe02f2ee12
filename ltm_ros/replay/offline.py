"""Offline replay: the graph's handlers in one process, without DDS, as fast as it goes, bit-repeatable."""

from __future__ import annotations

import importlib
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Set
from functools import partial
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any

from ltm_core.config_io import checked
from ltm_core.errors import LtmError
from ltm_msgs_py.bag.reader import BagMessage, BagReader
from ltm_msgs_py.bag.schemas import type_name_of
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.stamp import stamp_text
from ltm_ros.launching.graph import Graph, NodeSpec
from ltm_ros.replay.selection import Selection
from ltm_ros.runtime.handler import Handler, NodeType, Topic
from ltm_ros.runtime.health import Health, cause_of


class OfflineGraph:
    """Runs the nodes of a graph by calling their handlers, one message at a time, in the order of publication."""

    def __init__(self, graph: Graph, record: BagWriter | None = None, source: str = "") -> None:
        """`source`: where messages come from, for errors."""
        self._source = source
        self.healths: dict[str, Health] = {}
        self._listeners: dict[str, list[tuple[str, Health, Callable[[Any], None]]]] = defaultdict(list)
        self._waiting: deque[tuple[str, Any]] = deque()
        self._record = record
        self.now_ns = 0
        """Log time of the message at work."""
        self._handlers: dict[str, tuple[Health, Handler[Any]]] = {}
        self._publications: dict[str, list[str]] = {}
        self._subscriptions: dict[str, list[str]] = {}
        for spec in graph:
            self._add(spec)
        for _, handler in self._handlers.values():
            handler.start()
        self._drain()

    def feed(self, topic: str, message: Any, time_ns: int) -> None:
        """Deliver a message and all that follows from it."""
        self.now_ns = time_ns
        self.publish(topic, message)
        self._drain()

    def finish(self) -> None:
        """Tell every handler that no more will come, each after all that it listens to; what they still publish is
        delivered."""
        sources: dict[str, set[str]] = defaultdict(set)
        for name, topics in self._publications.items():
            for topic in topics:
                sources[topic].add(name)
        upstream = {name: set().union(*(sources[t] for t in topics)) for name, topics in self._subscriptions.items()}
        for name in TopologicalSorter(upstream).static_order():
            health, handler = self._handlers[name]
            _guarded(health, handler.finish)
            self._drain()

    def publish(self, topic: str, message: Any, latched: bool = False) -> None:
        self._waiting.append((topic, message))
        if self._record is not None:
            self._record.add_topic(topic, type_name_of(message), latched)
            self._record.write(topic, message, self.now_ns)

    def listened(self, topic: str) -> bool:
        return topic in self._listeners

    def _add(self, spec: NodeSpec) -> None:
        node: NodeType[Any] = importlib.import_module(spec.module).NODE
        given: Mapping[str, Any] = {k: v for k, v in spec.parameters.items() if k != "use_sim_time"}
        health = self.healths[spec.full_name] = Health()
        outlet = _Outlet(self, spec.namespace, health)
        handler = node.handler(checked(node.config, given, f"parameters of {spec.label}"), outlet, health)
        self._handlers[spec.full_name] = health, handler
        self._publications[spec.full_name] = [_absolute(spec.namespace, topic) for topic in handler.publications]
        self._subscriptions[spec.full_name] = [_absolute(spec.namespace, topic) for topic in handler.subscriptions]
        for topic, callback in handler.subscriptions.items():
            self._listeners[_absolute(spec.namespace, topic)].append((topic.name, health, callback))

    def _place(self, topic: str, message: Any) -> str:
        """Of a message, for errors: its topic, which names the camera, its stamp, and the recording."""
        parts = [topic, *([f"stamp {stamp_text(message)}"] if hasattr(message, "header") else []), self._source]
        return ", ".join(filter(None, parts))

    def _drain(self) -> None:
        while self._waiting:
            while self._waiting:
                topic, message = self._waiting.popleft()
                for name, health, callback in self._listeners.get(topic, ()):
                    health.received(name)
                    _guarded(health, partial(callback, message), partial(self._place, topic, message))
            for health, handler in self._handlers.values():
                _guarded(health, handler.idle)


class _Outlet:
    def __init__(self, graph: OfflineGraph, namespace: str, health: Health) -> None:
        self._graph, self._namespace, self._health = graph, namespace, health

    def publish(self, topic: Topic, message: Any) -> None:
        self._graph.publish(_absolute(self._namespace, topic), message, topic.latched)
        if not topic.latched:
            self._health.published(topic.name)

    def wanted(self, topic: Topic) -> bool:
        return self._graph.listened(_absolute(self._namespace, topic))

    def now_ns(self) -> int:
        return self._graph.now_ns

    def acknowledge(self, topic: Topic, stamp_ns: int) -> None:
        """Each frame is finished before the next is fed: nobody waits for it."""

    def workers(self, topic: Topic) -> Set[str]:
        return frozenset()


def replay_offline(
    selection: Selection,
    graph: Graph,
    record: Path | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> dict[str, dict[str, str]]:
    """Run a recording through a graph; each node's health summary by its full name.

    `record`: bag folder for inputs and results. Damaged messages of the recording are counted under `recording`.
    """
    writer = BagWriter(record) if record is not None else None
    try:
        offline = OfflineGraph(graph, writer, str(selection.reader.path))
        recording = offline.healths["recording"] = Health()
        for done, message in enumerate(selection, start=1):
            recording.received(message.topic)
            _guarded(recording, partial(_deliver, offline, selection.reader, message))
            recording.published(message.topic)
            progress(done)
        offline.finish()
    finally:
        if writer is not None:
            writer.close()
    return {name: health.summary() for name, health in offline.healths.items()}


def _absolute(namespace: str, topic: Topic) -> str:
    return topic.name if topic.name.startswith("/") else f"{namespace}/{topic.name}"


def _deliver(offline: OfflineGraph, reader: BagReader, message: BagMessage) -> None:
    offline.feed(message.topic, reader.decode(message), message.log_time_ns)


def _guarded(health: Health, work: Callable[[], None], place: Callable[[], str] | None = None) -> None:
    try:
        work()
    except LtmError as error:
        health.drop(cause_of(error), str(error) if place is None else f"{error} ({place()})")
