"""Run the nodes of all cameras of a site in one process: each camera is a pipeline, each node a job."""

from __future__ import annotations

import importlib
import queue
import sys
import time
from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass
from functools import partial
from typing import Any

import rclpy.node
from rclpy.parameter import Parameter

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.site.site_io import load_site
from ltm_ros.launching.graph import NodeSpec
from ltm_ros.runtime.camera_pipeline import CameraPipeline, FrameScheduler
from ltm_ros.runtime.delivery_checks import DiagnosticsPublisher
from ltm_ros.runtime.handler import NodeType, Topic
from ltm_ros.runtime.heartbeat import HEARTBEAT
from ltm_ros.runtime.node_process import EX_IOERR
from ltm_ros.runtime.outlet_node import WIRING_S, OutletNode
from ltm_ros.runtime.pipeline import Job, absolute
from ltm_ros.runtime.retry import LateStart, cannot_start
from ltm_ros.runtime.ros_environment import available_cores

CLOSE_S = 5.0
"""Time in seconds for frames in flight to finish after a stop request."""


DESCRIBED = 8
"""Number of cameras with ROS services for their nodes' parameters, which take 5 MB a camera."""


class JobNode(OutletNode):
    """A node whose handler is a job of its camera's pipeline. Messages for other jobs of the pipeline are passed
    directly, others go over DDS. `described`: whether other programs can ask for its parameters."""

    def __init__(self, spec: NodeSpec, camera: CameraPipeline, described: bool = True) -> None:
        node_type: NodeType[Any] = importlib.import_module(spec.module).NODE
        super().__init__(
            node_type,
            {
                "node_name": spec.name,
                "namespace": spec.namespace,
                "cli_args": [],
                "use_global_arguments": False,
                "start_parameter_services": described,
                "parameter_overrides": [Parameter(name, value=value) for name, value in spec.parameters.items()],
            },
        )
        self.spec = spec
        self._camera, self._pipeline = camera, camera.pipeline
        self._heard_here: Set[Topic] = frozenset()
        """Acknowledgements that a job of this pipeline also receives over DDS, because nodes elsewhere send them, too.
        """
        make: Callable[[], Any] = partial(node_type.handler, self.config, self, self.health)
        self.job = Job(spec.full_name, spec.namespace, self.health, make)
        handler = self.job.handler
        if handler.services or handler.discoverable:
            raise ConfigError(f"{spec.label}: a node with services or topics by pattern needs a process of its own")
        for topic in handler.publications:
            self.open(topic)
        self._pipeline.add(self.job)

    def subscribe(self, wake: Callable[[], None]) -> None:
        """Subscribe over DDS to topics that no job of the pipeline publishes; call it after all jobs are added."""
        for topic in self.job.callbacks:
            if not self._pipeline.made_here(self.job.topic(topic)):
                self.listen(topic, topic.name, partial(self._offer, wake, topic))
        # Last: a node that is known to acknowledge frames must also receive them.
        for topic in self.job.handler.acknowledgements:
            self.open(topic)
        self._heard_here = {t for t in self.job.handler.acknowledgements if self._pipeline.listened(self.job.topic(t))}

    def publish(self, topic: Topic, message: Any) -> None:
        """Implement Outlet."""
        self._hand_over(topic, message)
        super().publish(topic, message)

    def provide(self, topic: Topic, stamp_ns: int, make: Callable[[], Any]) -> None:
        """Implement Outlet."""
        if not self._pipeline.listened(self.job.topic(topic)):
            super().provide(topic, stamp_ns, make)
            return
        message = make()
        self._hand_over(topic, message)
        super().provide(topic, stamp_ns, lambda: message)

    def more_waits(self) -> bool:
        """Implement Outlet."""
        return self._camera.more_waits

    def acknowledge(self, topic: Topic, stamp_ns: int) -> None:
        """Implement Outlet."""
        message = self.acknowledgement(stamp_ns)
        self._hand_over(topic, message)
        if self._publishers_by_topic[topic].get_subscription_count() > (topic in self._heard_here):
            self.send(topic, message)

    def workers(self, topic: Topic) -> Set[str]:
        """Implement Outlet."""
        return super().workers(topic) | self.prompt_workers(topic)

    def prompt_workers(self, topic: Topic) -> Set[str]:
        """Implement Outlet."""
        name = self.job.topic(topic)
        return {
            job.name
            for job in self._pipeline.jobs.values()
            if name in {job.topic(own) for own in job.handler.acknowledgements}
        }

    def _hand_over(self, topic: Topic, message: Any) -> None:
        if self._pipeline.listened(name := absolute(self.spec.namespace, topic)):
            self._pipeline.publish(name, message, topic.latched)

    def _offer(self, wake: Callable[[], None], topic: Topic, message: Any) -> None:
        if topic.counted:
            self.health.received(topic.name)
        try:
            self._camera.offer(self.job, topic, message)
        except queue.Full:
            self.health.drop(
                "overload", f"{self._camera.waiting} messages are queued already; reduce the frame rate or add cores"
            )
        wake()


@dataclass(frozen=True)
class _CameraNodes:
    nodes: list[JobNode]
    pipeline: CameraPipeline

    def destroy(self) -> None:
        for node in self.nodes:
            node.destroy_node()


class SiteProcess:
    """All nodes of `specs`; the nodes of one namespace belong to one camera. A camera whose nodes cannot be created is
    reported, and tried again later (`LateStart`). Raises the first LtmError if no camera works."""

    def __init__(self, specs: Sequence[NodeSpec]) -> None:
        self._members: list[JobNode] = []
        self._cameras: list[CameraPipeline] = []
        self._diagnostics: list[DiagnosticsPublisher] = []
        workers = load_site(str(specs[0].parameters["site"])).workers or available_cores()
        self._scheduler = FrameScheduler(workers, HEARTBEAT)
        faults: list[LtmError] = []
        left_out: dict[str, Callable[[], _CameraNodes]] = {}
        reasons: dict[str, str] = {}
        for namespace in dict.fromkeys(spec.namespace for spec in specs):
            make = partial(self._make_camera, [spec for spec in specs if spec.namespace == namespace])
            try:
                self._add_camera(make())
            except LtmError as error:
                faults.append(error)
                left_out[namespace], reasons[namespace] = make, str(error)
            except Exception as error:
                sys.excepthook(*sys.exc_info())
                left_out[namespace], reasons[namespace] = make, repr(error)
        for namespace, why in reasons.items():
            _say(cannot_start(namespace, why) if self._cameras else f"{namespace}: cannot start: {why}")
        self._late = LateStart(left_out, reasons, _say)
        if not self._cameras:
            raise faults[0] if faults else RuntimeError("no camera's nodes can be started; see the messages above")
        self._ticked = time.monotonic()
        first = self._members[0]
        first.create_timer(0.5, self._tick, clock=DiagnosticsPublisher.steady_clock())
        first.create_timer(WIRING_S, self._look_at_wiring, clock=DiagnosticsPublisher.steady_clock())
        self._scheduler.start()

    @property
    def members(self) -> Sequence[rclpy.node.Node]:
        """Return the members; a late camera is added when it starts."""
        return self._members

    def close(self) -> int:
        """Finish frames in flight and close the handlers; return the process's exit status."""
        for late in self._late.close(CLOSE_S):
            late.destroy()
        for camera in self._cameras:
            camera.stop_admitting()
        finished = self._scheduler.close(CLOSE_S)
        if finished:
            for camera in self._cameras:
                camera.finish()
        for diagnostics in self._diagnostics:
            diagnostics.publish()
        return 0 if finished else EX_IOERR

    def _make_camera(self, specs: Sequence[NodeSpec]) -> _CameraNodes:
        nodes: list[JobNode] = []

        def say(name: str, text: str) -> None:
            next(node for node in nodes if node.spec.full_name == name).warn(text)

        made = _CameraNodes(nodes, CameraPipeline(say))
        try:
            for spec in specs:
                nodes.append(JobNode(spec, made.pipeline, len(self._cameras) < DESCRIBED))
            made.pipeline.pipeline.start()
            for node in nodes:
                node.subscribe(partial(self._scheduler.wake, made.pipeline))
        except BaseException:
            made.destroy()
            raise
        return made

    def _add_camera(self, made: _CameraNodes) -> None:
        healths = {node.spec.full_name: node.health for node in made.nodes}
        self._diagnostics.append(DiagnosticsPublisher(made.nodes[0], healths, made.nodes[0].config.camera))
        self._members += made.nodes
        self._cameras.append(made.pipeline)

    def _tick(self) -> None:
        now = time.monotonic()
        waited, self._ticked = now - self._ticked, now
        for late in self._late.tick(waited):
            self._add_camera(late)
        for node in self._members:
            node.state_listeners()
        self._members[0].look_at_clock()
        for camera in self._cameras:
            next(iter(camera.pipeline.jobs.values())).health.gauge("queue", camera.waiting)
            camera.tick(waited)
            self._scheduler.wake(camera)

    def _look_at_wiring(self) -> None:
        for node in self._members:
            node.look_at_wiring()


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
