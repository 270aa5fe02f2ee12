"""Replay offline through the graph's handlers: select the messages of a bag, and play them in order."""

import importlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ltm_core.base.errors import LtmError, RecordingError
from ltm_core.base.number_text import DAY_NS
from ltm_core.site.site import Site
from ltm_core.storage.config_io import checked
from ltm_msgs_py.bag.cdr import TF_TYPE, CameraFrames
from ltm_msgs_py.bag.reader import BagMessage, BagReader
from ltm_msgs_py.bag.schemas import type_name_of
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.stamp import ns_to_time, stamp_of, stamp_text, time_text
from ltm_ros.launching.graph import Graph, NodeSpec
from ltm_ros.recordings.inputs import InputReader, beside_expected, decoded_input, is_image, warn_of_ignored
from ltm_ros.runtime.handler import NodeType, Topic
from ltm_ros.runtime.health import Health, cause_of
from ltm_ros.runtime.pipeline import Job, Pipeline
from ltm_ros.runtime.topics import CAMERA_TRUTH, POSED_POSE, camera_topic

RECORDING = "recording"
"""Name of the recording in the summaries of a replay, beside those of the nodes."""


Summaries = dict[str, dict[str, str]]
"""Health summary of each node by its full name."""


@dataclass(frozen=True)
class Selection:
    """The input topics of a site's cameras in a bag, and a time span.

    `start`, `duration`: seconds from the bag's first message. Results of the graph are never replayed. `health`: counts
    messages, those that are invalid, and those lost in damaged parts."""

    inputs: InputReader
    topics: dict[str, Topic]
    """Topics by absolute name, as their nodes subscribe to them."""
    begin_ns: int
    end_ns: int
    """One ns past the last message's log time."""
    message_count: int
    frame_count: int
    health: Health = field(default_factory=Health)

    @classmethod
    def open(
        cls,
        bag: Path,
        site: Site,
        start: float = 0.0,
        duration: float | None = None,
        names: Mapping[str, str] | None = None,
    ) -> "Selection":
        """Open a bag; `names`: other names of its topics. Raises RecordingError without images in the span."""
        reader = BagReader(bag, names=names)
        recorded = reader.topics()
        inputs = InputReader(reader, site)
        topics = inputs.topics
        images = [name for name, topic in topics.items() if is_image(topic)]
        for camera in site.cameras:
            named = {camera_topic(site.name, camera, topic): topic for topic in CAMERA_TRUTH}
            topics |= {name: topic for name, topic in named.items() if name in recorded}
        if not images or reader.start_ns is None or reader.end_ns is None:
            beside = "; ".join((beside_expected(site, recorded), *reader.damage))
            raise RecordingError(f"{bag} has no images of site {site.name} ({', '.join(site.cameras)}); {beside}")
        begin = reader.start_ns + round(start * 1e9)
        end = reader.end_ns + 1 if duration is None else min(begin + round(duration * 1e9), reader.end_ns + 1)
        whole = start == 0 and duration is None and not reader.damage and not inputs.sources
        counts = (
            Counter({topic: reader.topic_infos()[topic].message_count for topic in topics})
            if whole  # from the bag's index; a part, or a truncated bag, must be read
            else Counter(message.topic for message in inputs.messages(topics, begin, end))
        )
        if not counts.total():
            last, long = ((at - reader.start_ns) / 1e9 for at in (end, reader.end_ns))
            raise RecordingError(f"{bag} has nothing between {start} s and {last:.1f} s; it is {long:.1f} s long")
        frames = sum(counts[topic] for topic in images)
        selection = cls(inputs, topics, begin, end, counts.total(), frames)
        warn_of_ignored(site, selection.first)
        return selection

    def __iter__(self) -> Iterator[BagMessage]:
        return self.inputs.messages(self.topics, self.begin_ns, self.end_ns)

    def decoded(self, shift_ns: int = 0) -> Iterator[tuple[BagMessage, Any]]:
        """Yield each message with its content, its stamp moved by `shift_ns`; count those that are invalid or lost."""
        for message in self:
            counted = self.topics[message.topic].counted
            if counted:
                self.health.received(message.topic)
            try:
                content = self.content(message)
                if shift_ns:
                    content.header.stamp = ns_to_time(stamp_of(content) + shift_ns)
            except LtmError as error:
                self.health.drop(cause_of(error), f"{error} ({message.topic}, {time_text(message.log_time_ns)})")
                continue
            yield message, content
            if counted:
                self.health.published(message.topic)
        lost = self.inputs.reader.lost
        count = sum(number for topic, number in lost.items() if not topic or topic in self.topics)
        if count and "damage" not in self.health.dropped:  # only in the first round of a loop
            self.health.drop("damage", "; ".join(self.inputs.reader.damage), count)

    def content(self, message: BagMessage) -> Any:
        """Return a message as its topic's type. Raises LtmError."""
        return decoded_input(self.topics[message.topic], message.raw, message.type_name, message.encoding)

    def first(self, name: str, topic: Topic) -> Any:
        """Return the first message of a recorded topic; None without any. Raises LtmError."""
        message = next(self.inputs.messages([name], self.begin_ns, self.end_ns), None) if name in self.topics else None
        return None if message is None else self.content(message)


def require_frames(bag: Path, site: Site, summaries: Summaries, names: Mapping[str, str] | None = None) -> None:
    """Raise RecordingError with the reasons if no frame reached the fuel map; with the topics if none was complete."""
    if int(summaries.get(f"/{site.name}/fuel_map", {}).get("frames", "0")):
        return
    said = [(*key.partition(".")[::2], text) for summary in summaries.values() for key, text in summary.items()]
    reasons = {text for kind, _, text in said if kind == "reason"}
    reasons |= {f"{text} x {what}" for kind, what, text in said if kind == "noted" and what.startswith("unusable")}
    why = "; ".join(sorted(reasons))
    if any(int(s["frames_out"]) for name, s in summaries.items() if name.endswith("/fuel_votes")):
        why = why or "no frame shows a cell of it; check the poses and the DEM's extent"
        raise RecordingError(f"{bag}: no frame reached the fuel map, which is empty: {why}")
    beside = beside_expected(site, BagReader(bag, names=names).topics())
    why = why or "no image met a pose and a calibration"
    raise RecordingError(f"{bag}: no frame was finished: {why}. {beside[0].upper()}{beside[1:]}")


def require_whole(bag: Path, summaries: Summaries) -> None:
    """Raise RecordingError if messages of the bag were lost or invalid, with the reasons."""
    recorded = summaries.get(RECORDING, {})
    causes = {key.removeprefix("reason."): why for key, why in recorded.items() if key.startswith("reason.")}
    if causes:
        counts = ", ".join(f"{recorded[f'dropped.{cause}']} by {cause} ({why})" for cause, why in causes.items())
        raise RecordingError(f"{bag}: {recorded['dropped']} messages are lost or invalid: {counts}. The rest was used")


class OfflineGraph:
    """Runs the nodes of a graph by calling their handlers, one message at a time, in the order of publication."""

    def __init__(self, graph: Graph, record: BagWriter | None = None, source: str = "") -> None:
        """Create the handlers. `source`: name of the recording, for errors."""
        self._source = source
        self.healths: dict[str, Health] = {}
        self._pipeline = Pipeline(self._run)
        self._record = record
        cameras = {spec.namespace: str(spec.parameters["camera"]) for spec in graph if spec.parameters.get("camera")}
        self._frames = CameraFrames({f"{place}/{POSED_POSE.name}": name for place, name in cameras.items()})
        self.now_ns = 0
        """Log time of the current message."""
        for spec in graph:
            self._add(spec)
        self._pipeline.start()
        self._pipeline.settle()

    def feed(self, topic: str, message: Any, time_ns: int) -> None:
        """Deliver a message and all that follow from it."""
        if 0 < self.now_ns // DAY_NS < time_ns // DAY_NS:
            self._pipeline.end_of_day()
        self.now_ns = time_ns
        self.publish(topic, message)
        self._pipeline.settle()

    def finish(self) -> None:
        """Finish every handler after those that it depends on, and deliver the results."""
        self._pipeline.finish()

    def publish(self, topic: str, message: Any, latched: bool = False) -> None:
        self._pipeline.publish(topic, message)
        if self._record is not None:
            self._record.add_topic(topic, type_name_of(message), latched)
            self._record.write(topic, message, self.now_ns)
            for name, raw, once in self._frames.beside(topic, message):
                self._record.add_topic(name, TF_TYPE, once)
                self._record.write_raw(name, TF_TYPE, raw, self.now_ns)

    def wanted(self, topic: str) -> bool:
        """Return whether anything uses a message of this topic."""
        return self._record is not None or self.listened(topic)

    def listened(self, topic: str) -> bool:
        return self._pipeline.listened(topic)

    def _add(self, spec: NodeSpec) -> None:
        node: NodeType[Any] = importlib.import_module(spec.module).NODE
        given: Mapping[str, Any] = {k: v for k, v in spec.parameters.items() if k != "use_sim_time"}
        health = self.healths[spec.full_name] = Health()
        outlet = _Outlet(self, spec.namespace, health)
        config = checked(node.config, given, f"parameters of {spec.label}")
        self._pipeline.add(Job(spec.full_name, spec.namespace, health, node.handler(config, outlet, health)))

    def _run(self, job: Job, work: Callable[[], None], topic: str, message: Any) -> None:
        try:
            work()
        except LtmError as error:
            stamp = f"stamp {stamp_text(message)}" if hasattr(message, "header") else ""
            place = ", ".join(filter(None, (topic, stamp, self._source))) if topic else ""
            job.health.drop(cause_of(error), f"{error} ({place})" if place else str(error))


class _Outlet:
    def __init__(self, graph: OfflineGraph, namespace: str, health: Health) -> None:
        self._graph, self._namespace, self._health = graph, namespace, health

    def publish(self, topic: Topic, message: Any) -> None:
        self._graph.publish(topic.under(self._namespace), message, topic.latched)
        if not topic.latched:
            self._health.published(topic.name)

    def provide(self, topic: Topic, stamp_ns: int, make: Callable[[], Any]) -> None:
        if self._graph.wanted(topic.under(self._namespace)):
            self.publish(topic, make())
        else:
            self._health.published(topic.name)

    def wanted(self, topic: Topic) -> bool:
        return self._graph.listened(topic.under(self._namespace))

    def more_waits(self) -> bool:
        """Each frame is finished before the next is fed, so none is dropped for a newer one."""
        return False

    def now_ns(self) -> int:
        return self._graph.now_ns


def replay_offline(
    selection: Selection, graph: Graph, record: Path | None = None, progress: Callable[[int], None] = lambda done: None
) -> Summaries:
    """Run a recording through a graph; return each node's health summary by its full name.

    `record`: bag folder for inputs and results. Damaged messages of the recording are counted under `recording`."""
    writer = BagWriter(record) if record is not None else None
    try:
        offline = OfflineGraph(graph, writer, str(selection.inputs.reader.path))
        offline.healths[RECORDING] = selection.health
        for done, (message, content) in enumerate(selection.decoded(), start=1):
            try:
                offline.feed(message.topic, content, message.log_time_ns)
            except LtmError as error:
                selection.health.drop(cause_of(error), str(error))
            progress(done)
        offline.finish()
    finally:
        if writer is not None:
            writer.close()
    return {name: health.summary() for name, health in offline.healths.items()}
