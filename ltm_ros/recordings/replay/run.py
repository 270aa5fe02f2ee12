"""Replay a recording: live over DDS at the pace of its stamps, or offline."""

import math
import threading
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from ltm_core.base.errors import LtmError, RecordingError
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_msgs_py.bag.schemas import type_name_of
from ltm_msgs_py.stamp import ns_to_time
from ltm_ros.launching.graph import Graph, ParameterValue, describe
from ltm_ros.launching.kernels import compile_ahead
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.site_check import require_ready
from ltm_ros.recordings.inputs import is_image
from ltm_ros.recordings.replay import LONGEST_PAUSE
from ltm_ros.recordings.replay.offline import RECORDING, Selection, Summaries, replay_offline
from ltm_ros.runtime.delivery_checks import unmatched
from ltm_ros.runtime.ros_environment import apply_to_process, wait_for_quiet
from ltm_ros.runtime.topics import CAMERA_TRUTH

CLOCK_PERIOD = 0.025
"""Seconds of real time between `/clock` messages."""
WAITING = 5
"""Frames of a camera that wait for admission, above which the recording's time is paused."""
SILENT = 5.0
"""Seconds without diagnostics after which a node is no longer waited for."""
WARM_UP = 60.0
"""Maximum number of seconds to wait for the first frames."""
QUIET = 2.5
"""Seconds without any change in the graph's diagnostics after which it is idle."""


Progress = Callable[[int, int], None]
"""Gets the number of messages done, and of all."""


class LivePlayer:
    """Publishes a selection and watches the diagnostics of the graph. A context manager."""

    def __init__(self, selection: Selection, rate: float = 1.0, longest_pause: float = math.inf) -> None:
        """Open the player. `rate`: 2 is twice as fast. `longest_pause`: seconds of a recorded pause, after which the
        clock skips the rest if the graph is idle. Raises RecordingError unless both are positive."""
        if not 0 < rate < 1e4:
            raise RecordingError(f"replay rate must be a positive number such as 1 or 0.5, got {rate}")
        if not longest_pause > 0:
            raise RecordingError(f"the longest pause of a replay must exceed 0 s, such as 10, got {longest_pause}")
        self._selection, self._rate, self._longest_pause = selection, rate, longest_pause
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = Node("player", context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        qos = QoSProfile(depth=30, reliability=ReliabilityPolicy.RELIABLE)
        self._publishers = {
            name: self._node.create_publisher(topic.type, name, qos) for name, topic in selection.topics.items()
        }
        self._clock = self._node.create_publisher(Clock, "/clock", 10)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        self.summaries: Summaries = {}
        """The last diagnostics of every node, by full name."""
        self._heard: dict[str, float] = {}
        self._changed = time.monotonic()
        self._epoch = (time.monotonic(), selection.begin_ns)
        self._stopping = threading.Event()
        self._threads = [threading.Thread(target=target, daemon=True) for target in (self._spin, self._tick)]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        for thread in self._threads:
            thread.join()
        self._executor.shutdown()
        wait_for_quiet(self._node)
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def wait_for_listeners(self, nodes: int = 0, timeout: float = 30.0) -> None:
        """Wait until images have subscribers, `nodes` nodes have reported and take the clock, and all match for a
        second.

        Raises RecordingError after `timeout` seconds: no graph of this site runs in this ROS domain."""
        deadline, last, since = time.monotonic() + timeout, -1, time.monotonic()
        known, loose = 0, list[str]()
        images = [
            name for name, topic in self._selection.topics.items() if is_image(topic) and topic not in CAMERA_TRUTH
        ]
        while time.monotonic() < deadline:
            counts = {topic: publisher.get_subscription_count() for topic, publisher in self._publishers.items()}
            summaries = dict(self.summaries)
            known = min(self._clock.get_subscription_count(), len(summaries))
            loose = unmatched(self._node, summaries)
            if (now := sum(counts.values()) + known) != last or loose:
                last, since = now, time.monotonic()
            if min(counts[name] for name in images) > 0 and known >= nodes and time.monotonic() - since > 1.0:
                return
            time.sleep(0.05)
        raise RecordingError(
            f"no subscribers of {', '.join(images)} after {timeout:.0f} s; {known} of {nodes} nodes were ready, and "
            f"{', '.join(loose) or 'no topic'} not matched. Start the site's graph in the same ROS_DOMAIN_ID and with "
            "sim time, or let `ltm replay` start it"
        )

    def play(
        self, loop: bool = False, progress: Callable[[int], None] = lambda _: None, stopped: Callable[[], bool] = bool
    ) -> int:
        """Publish every message at its time; return the number published. `stopped` ends it early.

        The recording's time is paused while the graph is behind, and before the second frame of a camera until the
        first ones are finished, because those wait for networks and code that are used for the first time. With `loop`,
        stamps of later rounds are moved on with the clock, so that each stays unique."""
        span = self._selection.end_ns - self._selection.begin_ns
        # With the pause between two frames, and at least a second, for recordings of one photo.
        round_ns = max(span + span // max(self._selection.frame_count - 1, 1), 1_000_000_000)
        self._epoch = (time.monotonic(), self._selection.begin_ns)
        published, shift, begun, warm = 0, 0, set[str](), False
        while True:
            for message, content in self._selection.decoded(shift):
                if not warm and is_image(self._selection.topics[message.topic]):
                    if warm := message.topic in begun:
                        self._pause_until(self._first_frames_done(), stopped)
                    begun.add(message.topic)
                self._sleep_until(message.log_time_ns + shift, stopped)
                # A live camera's frames are shed if the graph is behind, but all recorded frames are processed.
                self._pause_until(lambda: not self._behind(), stopped)
                if stopped():
                    return published
                self._publish_clock()  # no node may receive a message from its future
                own = message.type_name == type_name_of(content)
                self._publishers[message.topic].publish(message.raw if own and not shift else content)
                published += 1
                progress(published)
            if not loop:
                return published
            shift += round_ns

    def drain(self, nodes: Collection[str], timeout: float = 120.0) -> bool:
        """Wait until the nodes' diagnostics do not change and queues are empty. Returns False after `timeout`."""
        deadline = time.monotonic() + timeout
        self._changed = time.monotonic()
        while time.monotonic() < deadline:
            if self._idle(self.summaries.get(name) for name in nodes):
                return True
            time.sleep(0.1)
        return False

    def now_ns(self) -> int:
        """Return the replay's time."""
        real, bag_ns = self._epoch
        return bag_ns + round(max(0.0, time.monotonic() - real) * self._rate * 1e9)

    def _pause_until(self, done: Callable[[], bool], stopped: Callable[[], bool]) -> None:
        at = self.now_ns()
        while not done() and not stopped():
            self._epoch = (time.monotonic() + 1.0, at)  # time is paused until it continues in a second
            time.sleep(0.05)
        self._epoch = (min(time.monotonic(), self._epoch[0]), self._epoch[1])

    def _first_frames_done(self) -> Callable[[], bool]:
        """Return a check, for `WARM_UP` seconds, whether the graph has finished all that waits for no later message."""
        self._changed = time.monotonic()
        deadline = self._changed + WARM_UP
        return lambda: time.monotonic() > deadline or self._idle(self.summaries.values(), ("queue",))

    def _behind(self) -> bool:
        recent = time.monotonic() - SILENT
        return any(
            self._heard[name] > recent
            and (int(summary.get("waiting", "0")) > WAITING or int(summary.get("queue", "0")) > 4 * WAITING)
            for name, summary in list(self.summaries.items())
        )

    def _sleep_until(self, bag_ns: int, stopped: Callable[[], bool]) -> None:
        steps_at = time.monotonic() + self._longest_pause
        while (wait := (bag_ns - self.now_ns()) / 1e9 / self._rate) > 0 and not stopped():
            now = time.monotonic()
            if now >= steps_at and self._idle(self.summaries.values()):
                self._epoch = (now, bag_ns)
                return
            time.sleep(min(wait, 0.1))

    def _idle(self, summaries: Iterable[dict[str, str] | None], busy: Sequence[str] = ("queue", "waiting")) -> bool:
        """Return whether nothing has changed for a while, and nothing is queued (a large frame may take longer)."""
        empty = all(s is not None and {s.get(key, "0") for key in busy} == {"0"} for s in list(summaries))
        return empty and time.monotonic() - self._changed > QUIET

    def _tick(self) -> None:
        while not self._stopping.wait(CLOCK_PERIOD):
            self._publish_clock()

    def _publish_clock(self) -> None:
        self._clock.publish(Clock(clock=ns_to_time(self.now_ns())))

    def _spin(self) -> None:
        while not self._stopping.is_set():
            self._executor.spin_once(timeout_sec=0.1)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            summary = {item.key: item.value for item in status.values}
            before = self.summaries.get(status.name, {})
            if any(before.get(key) != summary.get(key) for key in ("frames_in", "frames_out", "dropped")):
                self._changed = time.monotonic()
            self._heard[status.name] = time.monotonic()
            self.summaries[status.name] = summary


@dataclass(frozen=True)
class ReplayOptions:
    """`start`, `duration`: seconds of the recording. `export`: GeoTIFF of the fuel map. `record`: bag of the results.

    `state`: an existing folder for what nodes keep; None: it ends with the replay. `rrd`: Rerun recording. `rate`,
    `loop`, `longest_pause` (`LivePlayer`), `domain_id`: of live replay only. `names`: other names of recorded
    topics."""

    start: float = 0.0
    duration: float | None = None
    export: Path | None = None
    record: Path | None = None
    state: Path | None = None
    rrd: Path | None = None
    rate: float = 1.0
    loop: bool = False
    longest_pause: float = LONGEST_PAUSE
    domain_id: int | None = None
    names: Mapping[str, str] = field(default_factory=dict)

    def selection(self, bag: Path, site: Site) -> Selection:
        """Open the recording. Raises RecordingError."""
        return Selection.open(bag, site, self.start, self.duration, names=self.names)


def graph_of(site_path: Path, options: ReplayOptions, sim_time: bool) -> Graph:
    """Return the site's graph with the given options."""
    fuel_map: dict[str, ParameterValue] = {}
    if options.export is not None:
        fuel_map["export_path"] = str(options.export.resolve())
    kept: dict[str, ParameterValue] = {} if options.state is None else {"folder": str(options.state.resolve())}
    return describe(
        load_site(site_path),
        site_path,
        sim_time=sim_time,
        view=None if options.rrd is None else {"save": str(options.rrd.resolve())},
        record=None if options.record is None or not sim_time else {"bag": str(options.record.resolve())},
        parameters={"fuel_map": fuel_map | kept, "terrain": kept, "pose": kept},
        sources=False,
    )


def run_offline(bag: Path, site_path: Path, options: ReplayOptions, progress: Progress) -> Summaries:
    """Without DDS; each node's health summary. Raises LtmError on bad input."""
    selection = options.selection(bag, load_site(site_path))
    graph = graph_of(site_path, options, sim_time=False)
    total = selection.message_count
    return replay_offline(selection, graph, options.record, lambda done: progress(done, total))


def publish(
    bag: Path, site_path: Path, options: ReplayOptions, progress: Progress, stopped: Callable[[], bool]
) -> Summaries:
    """Play into a graph that runs already; return the summary of the recording. Raises LtmError."""
    apply_to_process(options.domain_id)
    selection = options.selection(bag, load_site(site_path))
    with LivePlayer(selection, options.rate, options.longest_pause) as player:
        player.wait_for_listeners()
        player.play(options.loop, lambda done: progress(done, selection.message_count), stopped)
    return {RECORDING: selection.health.summary()}


def run_live(
    bag: Path,
    site_path: Path,
    options: ReplayOptions,
    progress: Progress,
    console: Callable[[str], None],
    stopped: Callable[[], bool] = bool,
) -> Summaries:
    """Replay with the whole graph in processes of its own; return the last diagnostics of every node by full name.

    Raises NotReadyError if it cannot work, LtmError if it does not start or does not finish its work."""
    site = require_ready(site_path, {}, console)
    selection = options.selection(bag, site)
    apply_to_process(options.domain_id)
    graph = graph_of(site_path, options, sim_time=True)
    if options.rrd is not None:
        options.rrd.unlink(missing_ok=True)  # else the viewer would write another beside that of the last replay
    total = selection.message_count
    compile_ahead(graph, site_path, console)
    with Runner(graph, domain_id=options.domain_id, console=console) as runner:
        runner.wait_until_ready(timeout_s=180.0)
        with LivePlayer(selection, options.rate, options.longest_pause) as player:
            player.wait_for_listeners(len(graph))
            player.play(options.loop, lambda done: progress(done, total), stopped)
            if not player.drain([node.full_name for node in graph]):
                raise LtmError(
                    "the graph is still working two minutes after the recording's end; see its messages above"
                )
            runner.stop()
            return {**player.summaries, RECORDING: selection.health.summary()}
