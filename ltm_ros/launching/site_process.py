"""Run the nodes of all cameras of a site in one process: each camera is a pipeline, each node a job.

`python -m ltm_ros.launching.site_process NODES.json` runs the nodes that the file lists (`nodes_json`)."""

import importlib
import queue
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import rclpy.node
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.parameter import Parameter

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.site.site_io import load_site
from ltm_msgs_py.status import status_message
from ltm_ros.launching.graph import CAMERAS_PROCESS, NodeSpec, nodes_of_json
from ltm_ros.runtime.camera_pipeline import CameraPipeline, FrameScheduler
from ltm_ros.runtime.delivery_checks import DiagnosticsPublisher
from ltm_ros.runtime.handler import NodeType, Topic
from ltm_ros.runtime.heartbeat import HEARTBEAT
from ltm_ros.runtime.node_process import EX_IOERR, run_until_stopped
from ltm_ros.runtime.outlet_node import WIRING_S, OutletNode
from ltm_ros.runtime.pipeline import Job
from ltm_ros.runtime.retry import Backoff
from ltm_ros.runtime.ros_environment import available_cores

CLOSE_S = 5.0
"""Time in seconds for frames in flight to finish after a stop request."""
LONGEST_PAUSE_S = 120.0
"""Longest pause in seconds between two attempts to create a camera's nodes, which read everything again."""
DESCRIBED = 8
"""Number of cameras with ROS services for their nodes' parameters, which take 5 MB a camera."""


class JobNode(OutletNode):
    """A node whose handler is a job of its camera's pipeline. Messages for other jobs of the pipeline are passed
    directly, others go over DDS. `described`: whether other programs can ask for its parameters."""

    def __init__(self, spec: NodeSpec, camera: CameraPipeline, described: bool) -> None:
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
        try:
            handler = node_type.handler(self.config, self, self.health)
            self.job = Job(spec.full_name, spec.namespace, self.health, handler)
            if handler.services:
                raise ConfigError(f"{spec.label}: a node with services needs a process of its own")
            for topic in handler.publications:
                self.open(topic)
        except BaseException:
            self.destroy_node()
            raise
        self._pipeline.add(self.job)

    def subscribe(self, wake: Callable[[], None]) -> None:
        """Subscribe over DDS to topics that no job of the pipeline publishes; call it after all jobs are added."""
        for topic in self.job.callbacks:
            if not self._pipeline.made_here(topic.under(self.spec.namespace)):
                self.listen(topic, partial(self._offer, wake, topic))

    def publish(self, topic: Topic, message: Any) -> None:
        self._hand_over(topic, message)
        super().publish(topic, message)

    def provide(self, topic: Topic, stamp_ns: int, make: Callable[[], Any]) -> None:
        if not self._pipeline.listened(topic.under(self.spec.namespace)):
            super().provide(topic, stamp_ns, make)
            return
        message = make()
        self._hand_over(topic, message)
        super().provide(topic, stamp_ns, lambda: message)

    def more_waits(self) -> bool:
        return self._camera.more_waits

    def _hand_over(self, topic: Topic, message: Any) -> None:
        if self._pipeline.listened(name := topic.under(self.spec.namespace)):
            self._pipeline.publish(name, message)

    def _offer(self, wake: Callable[[], None], topic: Topic, message: Any) -> None:
        try:
            self._camera.offer(self.job, topic, message)
        except queue.Full:
            self.health.drop(
                "overload", f"{self._camera.waiting} messages are queued already; reduce the frame rate or add cores"
            )
        wake()


@dataclass
class _MissingCamera:
    """A camera whose nodes could not be created. `why`: as last reported; not the exception, which would keep what was
    created of them."""

    specs: Sequence[NodeSpec]
    pace: Backoff = field(default_factory=lambda: Backoff(longest_s=LONGEST_PAUSE_S))
    why: str = ""


class SiteProcess:
    """All nodes of `specs`; the nodes of one namespace belong to one camera. A camera whose nodes cannot be created is
    reported, also in the name of its first node on `/diagnostics`, and tried again later. Raises the first error if no
    camera works."""

    def __init__(self, specs: Sequence[NodeSpec]) -> None:
        self._members: list[JobNode] = []
        self._cameras: list[CameraPipeline] = []
        self._diagnostics: list[DiagnosticsPublisher] = []
        workers = load_site(str(specs[0].parameters["site"])).workers or available_cores()
        self._scheduler = FrameScheduler(workers, HEARTBEAT)
        self._missing: dict[str, _MissingCamera] = {}
        faults: list[Exception] = []
        for namespace in dict.fromkeys(spec.namespace for spec in specs):
            missing = _MissingCamera([spec for spec in specs if spec.namespace == namespace])
            if (fault := self._try(namespace, missing)) is not None:
                self._missing[namespace] = missing
                faults.append(fault)
        if not self._cameras:
            raise next((fault for fault in faults if isinstance(fault, LtmError)), faults[0])
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
        for camera in self._cameras:
            camera.closing = True
        finished = self._scheduler.close(CLOSE_S)
        if finished:
            for camera in self._cameras:
                camera.finish()
        for diagnostics in self._diagnostics:
            diagnostics.publish()
        return 0 if finished else EX_IOERR

    def _try(self, namespace: str, missing: _MissingCamera) -> Exception | None:
        """Create a camera's nodes; return why it failed. A new reason is reported."""
        try:
            self._add_camera(missing.specs)
        except Exception as error:
            before, missing.why = missing.why, str(error) or repr(error)
            missing.pace.failed()
            if missing.why != before:
                if not isinstance(error, LtmError):
                    sys.excepthook(*sys.exc_info())
                print(f"{namespace}: cannot start: {missing.why}; retrying later", file=sys.stderr, flush=True)
            return error.with_traceback(None)
        return None

    def _add_camera(self, specs: Sequence[NodeSpec]) -> None:
        nodes: list[JobNode] = []

        def say(name: str, text: str) -> None:
            next(node for node in nodes if node.spec.full_name == name).warn(text)

        camera = CameraPipeline(say)
        try:
            for spec in specs:
                nodes.append(JobNode(spec, camera, len(self._cameras) < DESCRIBED))
            camera.pipeline.start()
            for node in nodes:
                node.subscribe(partial(self._scheduler.wake, camera))
        except BaseException:
            for node in nodes:
                node.destroy_node()
            raise
        healths = {node.spec.full_name: node.health for node in nodes}
        others = list if self._diagnostics else self._not_started
        self._diagnostics.append(DiagnosticsPublisher(nodes[0], healths, nodes[0].config.camera, others))
        self._members += nodes
        self._cameras.append(camera)

    def _not_started(self) -> list[DiagnosticStatus]:
        """Return a status of each camera that cannot start, as its first node's."""
        said = {one.specs[0].full_name: f"cannot start: {one.why}; retrying later" for one in self._missing.values()}
        return [status_message(name, DiagnosticStatus.ERROR, why, {}) for name, why in said.items()]

    def _tick(self) -> None:
        now = time.monotonic()
        waited, self._ticked = now - self._ticked, now
        for namespace, missing in list(self._missing.items()):
            missing.pace.passed(waited)
            if missing.pace.due and self._try(namespace, missing) is None:
                del self._missing[namespace]
                print(f"{namespace}: started", file=sys.stderr, flush=True)
        for node in self._members:
            node.state_listeners()
        for camera in self._cameras:
            next(iter(camera.pipeline.jobs.values())).health.gauge("queue", camera.waiting)
            camera.tick(waited)
            self._scheduler.wake(camera)

    def _look_at_wiring(self) -> None:
        for node in self._members:
            node.look_at_wiring()


if __name__ == "__main__":
    SPECS = nodes_of_json(Path(sys.argv[1]).read_text(encoding="utf-8"))
    run_until_stopped(CAMERAS_PROCESS, lambda: SiteProcess(SPECS))
