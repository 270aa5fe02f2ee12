"""Run a graph without `launch`: start its processes, restart those that die, and stop all cleanly."""

import contextlib
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path

from ltm_core.base.errors import LtmError
from ltm_ros.launching import shared_memory
from ltm_ros.launching.graph import CAMERAS_MODULE, Graph, ProcessSpec, nodes_json, parameters_yaml
from ltm_ros.launching.service_manager import ServiceManager, in_words
from ltm_ros.launching.supervised import supervised_command
from ltm_ros.launching.supervisor import Console, NodeProcess, RestartPolicy
from ltm_ros.runtime.process_memory import Trimming
from ltm_ros.runtime.ros_environment import ros_environment

_QUIET = ("--disable-external-lib-logs",)
"""We keep a node's output; ROS's own log files in ~/.ros would grow without limit."""
SLOW_START_S = 120.0
"""Seconds after which `Runner.run` prints the nodes that are not ready: compiling kernels can take minutes."""


class GraphError(LtmError):
    """The graph did not start."""


def print_line(line: str) -> None:
    """Print a line to the terminal in one write, so that lines of several nodes do not mix. If the console cannot be
    written (full disk, closed terminal), the line is lost."""
    with contextlib.suppress(OSError):
        # Unbuffered: a buffer that cannot be flushed makes the process exit with an error.
        sys.stdout.flush()
        os.write(sys.stdout.fileno(), f"{line}\n".encode(errors="replace"))


def _signalled_until_stopped(processes: list[NodeProcess], number: int, patience_s: float) -> list[NodeProcess]:
    """Signal each new process of a node, because one may have been starting; return what runs after `patience_s`."""
    deadline, signalled = time.monotonic() + patience_s, set[int]()
    while alive := [process for process in processes if not process.wait_stopped(0)]:
        if time.monotonic() > deadline:
            break
        for process in alive:
            if (pid := process.pid) is not None and pid not in signalled:
                signalled.add(pid)
                process.signal(number, whole_group=number == signal.SIGKILL)
        alive[0].wait_stopped(0.02)
    return alive


def process_command(spec: ProcessSpec, folder: Path) -> list[str]:
    """Return the command of a supervised process, and write the description of its nodes into `folder`."""
    file = folder / spec.label.replace("/", ".")
    if spec.shared:
        nodes = file.with_name(f"{file.name}.json")
        nodes.write_text(nodes_json(spec.nodes), encoding="utf-8")
        return supervised_command(CAMERAS_MODULE, str(nodes), "--ros-args", *_QUIET)
    node = spec.nodes[0]
    parameters = file.with_name(f"{file.name}.yaml")
    parameters.write_text(parameters_yaml(node.parameters), encoding="utf-8")
    names = ["-r", f"__ns:={node.namespace}", "-r", f"__node:={node.name}"]
    return supervised_command(node.module, "--ros-args", *names, "--params-file", str(parameters), *_QUIET)


class Runner:
    """Starts, watches and stops the processes of `graph`; as a context manager it stops them at the end. Thread-safe.

    `domain_id`: ROS domain (None: from the environment). `console` gets every line of output, prefixed with the
    process's label. `stop_s`: time from SIGTERM to SIGKILL."""

    def __init__(
        self,
        graph: Graph,
        *,
        domain_id: int | None = None,
        console: Console = print_line,
        policy: RestartPolicy | None = None,
        stop_s: float = 10.0,
    ) -> None:
        self.graph = graph
        self.processes: dict[str, NodeProcess] = {}
        """Processes by label (`north/depth`, `fuel_map`, `cameras`), in the graph's order, after `start`."""
        self._domain_id = domain_id
        self._console_lock = threading.Lock()
        self._console = console
        self._policy = policy or RestartPolicy()
        self._stop_s = stop_s
        self._lock = threading.RLock()
        self._folder: Path | None = None
        self._stopping = threading.Event()

    def __enter__(self) -> "Runner":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def failing(self) -> list[str]:
        """Return the labels of the processes whose configuration was invalid at several starts in a row."""
        return [label for label, process in self.processes.items() if process.failing]

    @property
    def _required_failing(self) -> list[str]:
        return [spec.label for spec in self.graph.processes if spec.required and spec.label in self.failing]

    def start(self) -> None:
        """Start every process and return at once. Raises GraphError if the runner was started before."""
        with self._lock:
            if self.processes:
                raise GraphError(f"the graph of {self.graph.site} was started already; create a new Runner")
            shared_memory.remove_stale()
            self._folder = Path(tempfile.mkdtemp(prefix="ltm-run-"))
            for spec in self.graph.processes:
                self.processes[spec.label] = NodeProcess(
                    label=spec.label,
                    command=process_command(spec, self._folder),
                    environment=ros_environment(domain_id=self._domain_id, busy=spec.busy),
                    console=self._say,
                    policy=self._policy,
                    watchdog=self.graph.watchdog,
                    on_end=shared_memory.remove_stale,
                )
            for process in self.processes.values():
                process.start()

    def wait_until_ready(self, timeout_s: float = 60.0) -> None:
        """Wait until every node is ready (`not_ready`). Raises GraphError with the missing nodes and their last output,
        at once if a required one is failing."""
        deadline = time.monotonic() + timeout_s
        while missing := self._required_failing or self.not_ready():
            if self._required_failing or self._stopping.wait(0.05) or time.monotonic() > deadline:
                raise GraphError("\n".join(self._obituaries(missing)))

    def not_ready(self) -> list[str]:
        """Return the labels of the nodes that have not sent a diagnostic, which they do after loading; except those of
        failing processes."""
        there = [spec for spec in self.graph.processes if spec.label not in self.failing]
        ready = {name for spec in there for name in self.processes[spec.label].ready}
        return [node.label for spec in there for node in spec.nodes if node.full_name not in ready]

    def stop(self) -> None:
        """End every process (SIGTERM, SIGKILL after `stop_s`) and clean up. Idempotent. SIGINT is not used, because
        Python's exception can get lost during imports."""
        self._stopping.set()
        with self._lock:
            alive = list(self.processes.values())
            for process in alive:
                process.request_stop()
            for number, patience_s in ((signal.SIGTERM, self._stop_s), (signal.SIGKILL, 5.0)):
                if alive and number == signal.SIGKILL:
                    self._say(f"-- SIGKILL to {', '.join(process.label for process in alive)}, still running")
                alive = _signalled_until_stopped(alive, number, patience_s)
            if self._folder is not None:
                # That of killed nodes goes once no young object can be theirs.
                if shared_memory.remove_stale():
                    time.sleep(shared_memory.MIN_AGE_S)
                    shared_memory.remove_stale()
                shutil.rmtree(self._folder, ignore_errors=True)
                self._folder = None

    def run(self, manager: ServiceManager | None = None) -> int:
        """Run the graph until SIGINT, SIGTERM or SIGHUP (`ltm run`), from the main thread; also end if all required
        processes are failing. `manager` is notified. Returns 0, or 1 if a required process is failing."""
        manager = manager or ServiceManager()
        stopping = threading.Event()
        numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        former = {number: signal.signal(number, lambda *_: stopping.set()) for number in numbers}
        try:
            manager.report(f"starting {len(self.graph)} nodes", ready=False, alive=True)
            self.start()
            slow_at = time.monotonic() + SLOW_START_S
            trimming = Trimming(time.monotonic())
            ready = False
            while not stopping.wait(0.2):
                if not ready and (ready := not self.not_ready() and not self._required_failing):
                    without = f" but {', '.join(self.failing)}, tried again" if self.failing else ""
                    self._say(f"-- all {len(self.graph)} nodes are ready{without}")
                elif not ready and time.monotonic() > slow_at:
                    slow_at = float("inf")
                    for line in self._obituaries(self._required_failing or self.not_ready()):
                        self._say(f"-- {line}")
                # If each process is supervised, another start of the runner would not help.
                watched = all(process.watched for process in self.processes.values())
                state = ("" if ready else "starting; ") if watched else "a supervisor does not respond; "
                manager.report(state + in_words(self.processes.values()), ready, watched)
                trimming.look(time.monotonic())
                if len(self._required_failing) == sum(spec.required for spec in self.graph.processes):
                    self._say("-- all required nodes have failed")
                    break
        finally:
            manager.stopping()
            self.stop()
            for number, handler in former.items():
                signal.signal(number, handler)
        return 1 if self._required_failing else 0

    def _obituaries(self, lost: list[str]) -> list[str]:
        """Return in words which nodes or processes are lost, and the state and last output of their processes."""
        lines = [f"not ready: {', '.join(lost)}"]
        for spec in self.graph.processes:
            if spec.label in lost or any(node.label in lost for node in spec.nodes):
                process = self.processes[spec.label]
                state = "running" if process.running else "not running"
                how = f", last {process.last_exit}" if process.last_exit else ""
                lines.append(f"{spec.label}: {state}, {process.starts} starts{how}")
                lines += [f"  | {line}" for line in list(process.last_words)]
        return lines

    def _say(self, line: str) -> None:
        # A closed console (`ltm run | head`) does not end the graph.
        with self._console_lock, contextlib.suppress(OSError):
            self._console(line)
