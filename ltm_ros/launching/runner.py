"""Run a graph without `launch`: start its processes, restart those that die, and stop all cleanly."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess  # nosec B404 # argument lists, no shell
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TextIO

from ltm_core.base.errors import LtmError
from ltm_ros.launching import shared_memory
from ltm_ros.launching.graph import CAMERAS_MODULE, Graph, ProcessSpec, nodes_json, parameters_yaml
from ltm_ros.launching.service_manager import ServiceManager, all_watched, in_words
from ltm_ros.launching.supervised import start_supervised, supervised_command
from ltm_ros.launching.supervisor import Console, NodeProcess, ProcessState, RestartPolicy
from ltm_ros.launching.watchdog import GraphTraffic
from ltm_ros.runtime.process_memory import Trimming
from ltm_ros.runtime.ros_environment import ros_environment

_QUIET = ("--disable-external-lib-logs",)
"""We keep a node's output; ROS's own log files in ~/.ros would grow without limit."""
ASKED_AGAIN_S = 1.0
"""Delay in seconds before readiness is queried again after a failed query."""


class GraphError(LtmError):
    """The graph did not start."""


def print_line(line: str) -> None:
    """Print a line to the terminal in one write, so that lines of several nodes do not mix. If the console cannot be
    written (full disk, closed terminal), the line is lost."""
    with contextlib.suppress(OSError):
        # Unbuffered: a buffer that cannot be flushed makes the process exit with an error.
        sys.stdout.flush()
        os.write(sys.stdout.fileno(), f"{line}\n".encode(errors="replace"))


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
    remappings = [("__ns", node.namespace), ("__node", node.name), *node.remappings]
    command = supervised_command(node.module, "--ros-args")
    command += [part for old, new in remappings for part in ("-r", f"{old}:={new}")]
    return [*command, "--params-file", str(parameters), *_QUIET]


class Runner:
    """Starts, watches and stops the processes of `graph`; as a context manager it stops them at the end. Thread-safe.

    `domain_id`: ROS domain (None: from the environment). `log_folder`: receives each process's output as
    `<camera>.<node>.log`. `console` gets every line of output, prefixed with the process's label. `stop_s`: time from
    SIGTERM to SIGKILL. `environment`: additional variables.
    """

    def __init__(
        self,
        graph: Graph,
        *,
        log_folder: Path | str,
        domain_id: int | None = None,
        console: Console = print_line,
        policy: RestartPolicy | None = None,
        stop_s: float = 10.0,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.graph = graph
        self.log_folder = Path(log_folder)
        self.processes: dict[str, NodeProcess] = {}
        """Processes by label (`north/depth`, `fuel_map`, `cameras`), in the graph's order, after `start`."""
        self._domain_id = domain_id
        self._console_lock = threading.Lock()
        self._console = console
        self._policy = policy or RestartPolicy()
        self._stop_s = stop_s
        self._traffic = GraphTraffic()
        self._extra_environment = dict(environment or {})
        self._lock = threading.RLock()
        self._folder: Path | None = None
        self._changed = threading.Event()
        self._stopping = threading.Event()

    def __enter__(self) -> Runner:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def given_up(self) -> list[str]:
        """Return the labels of the processes that are no longer started because their configuration is invalid."""
        return [label for label, process in self.processes.items() if process.state is ProcessState.GIVEN_UP]

    @property
    def _lost_for_good(self) -> list[str]:
        """Return the abandoned processes without which the graph is useless."""
        return [label for label in self.given_up if self.graph.process(label).required]

    def start(self) -> None:
        """Start every process and return at once. Raises GraphError if the runner was started before."""
        with self._lock:
            if self.processes:
                raise GraphError(f"the graph of {self.graph.site} was started already; create a new Runner")
            shared_memory.remove_stale()
            self._warn_of_small_shm()
            self._folder = Path(tempfile.mkdtemp(prefix="ltm-run-"))
            for spec in self.graph.processes:
                self.processes[spec.label] = self._process(spec)
            for process in self.processes.values():
                process.start()

    def wait_until_ready(self, timeout_s: float = 60.0, *, discovered_suffices: bool = False) -> None:
        """Wait until each node has sent a diagnostic (or was discovered by DDS, with `discovered_suffices`), except
        optional ones that were given up. Raises GraphError with the missing nodes and their last output."""
        names = {node.full_name: node.label for node in self.graph}
        process_of = {node.label: process.label for process in self.graph.processes for node in process.nodes}
        command = supervised_command("ltm_ros.launching.readiness", "--timeout", str(timeout_s))
        command += ["--discovered"] if discovered_suffices else []
        watch, heartbeat = start_supervised([*command, *names], self._environment(busy=False))
        missing = dict(names)

        def awaited() -> list[str]:
            given_up = self.given_up
            return [label for label in missing.copy().values() if process_of[label] not in given_up]

        assert watch.stdout is not None  # nosec B101 # tells the type checker what holds

        def read(output: TextIO) -> None:
            for line in output:
                missing.pop(line.strip(), None)

        reader = threading.Thread(target=read, args=(watch.stdout,), daemon=True)
        reader.start()
        try:
            deadline = time.monotonic() + timeout_s + 5.0
            # Wait for its normal end: after a signal, its peers' shared memory would stay marked as in use.
            while watch.poll() is None and time.monotonic() < deadline:
                if self._lost_for_good or not awaited() or self._stopping.is_set():
                    break
                self._changed.wait(0.05)
                self._changed.clear()
        finally:
            if watch.poll() is None:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    watch.terminate()
                    watch.wait(2.0)
                watch.kill()
            watch.wait()
            reader.join(2.0)
            watch.stdout.close()
            os.close(heartbeat)
        lost = self._lost_for_good or awaited()
        if lost:
            processes = dict.fromkeys(process_of.get(label, label) for label in lost)
            raise GraphError("\n".join([f"not ready: {', '.join(lost)}", *map(self._obituary, processes)]))

    def kill(self, label: str, number: int = signal.SIGKILL) -> bool:
        """Send a signal to one process, for tests. Returns False if it is not running. Raises ConfigError."""
        self.graph.process(label)
        return self.processes[label].signal(number)

    def stop(self) -> None:
        """End every process (SIGTERM, SIGKILL after `stop_s`) and clean up. Idempotent. SIGINT is not used, because
        Python's exception can get lost during imports."""
        self._stopping.set()
        with self._lock:
            processes = list(self.processes.values())
            for process in processes:
                process.request_stop()
            for number, patience_s in ((signal.SIGTERM, self._stop_s), (signal.SIGKILL, 5.0)):
                alive = [process for process in processes if not process.wait_stopped(0)]
                if not alive:
                    break
                if number != signal.SIGTERM:
                    self._say(f"-- {signal.Signals(number).name} to {', '.join(p.label for p in alive)}, still running")
                self._signal_until_stopped(alive, number, patience_s)
            for process in processes:
                process.close()
            if self._folder is not None:
                self._remove_shared_memory()
                shutil.rmtree(self._folder, ignore_errors=True)
                self._folder = None

    def run(self, manager: ServiceManager | None = None) -> int:
        """Run the graph until SIGINT, SIGTERM or SIGHUP (`ltm run`), from the main thread; also end if no required node
        is left. `manager` is notified. Returns 0, or 1 if a required node was given up."""
        manager = manager or ServiceManager()
        stopping = threading.Event()
        numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        former = {number: signal.signal(number, lambda *_: stopping.set()) for number in numbers}
        required = [process.label for process in self.graph.processes if process.required]
        herald = threading.Thread(target=self._announce, args=(manager,), name="announce", daemon=True)
        try:
            manager.starting(f"starting {len(self.graph)} nodes")
            self.start()
            herald.start()
            trimming = Trimming(time.monotonic())
            while not stopping.wait(0.2):
                self._report(manager)
                trimming.look(time.monotonic())
                if all(label in self.given_up for label in required):
                    self._say("-- all required nodes have failed")
                    break
        finally:
            manager.stopping()
            self.stop()
            if herald.ident is not None:
                herald.join(5.0)
            manager.close()
            for number, handler in former.items():
                signal.signal(number, handler)
        return 1 if any(label in self.given_up for label in required) else 0

    def _announce(self, manager: ServiceManager) -> None:
        """Report when the graph is ready, and after a while which nodes are not: compiling kernels can take minutes."""
        told = False
        while not self._stopping.is_set():
            try:
                self.wait_until_ready(120.0)
            except (GraphError, OSError) as error:  # the machine cannot start another process now
                if not told and not self._stopping.is_set():
                    for line in str(error).splitlines():
                        self._say(f"-- {line}")
                told = True
                if self._lost_for_good:
                    return
                self._stopping.wait(ASKED_AGAIN_S)
            else:
                without = f" but {', '.join(self.given_up)}, given up" if self.given_up else ""
                self._say(f"-- all {len(self.graph)} nodes are ready{without}")
                manager.ready(in_words(self.processes.values()))
                return

    def _report(self, manager: ServiceManager) -> None:
        processes = self.processes.values()
        status = in_words(processes)
        if not all_watched(processes):
            manager.status(f"a supervisor does not respond; {status}")
        elif manager.is_ready:
            manager.alive(status)
        else:
            manager.starting(f"starting; {status}")

    def _process(self, spec: ProcessSpec) -> NodeProcess:
        assert self._folder is not None  # nosec B101 # tells the type checker what holds
        return NodeProcess(
            label=spec.label,
            command=process_command(spec, self._folder),
            environment=self._environment(spec.busy),
            log_file=self.log_folder / f"{spec.label.replace('/', '.')}.log",
            console=self._say,
            policy=self._policy,
            watchdog=self.graph.watchdog,
            traffic=self._traffic,
            on_end=shared_memory.remove_stale,
            on_given_up=self._changed.set,
        )

    def _environment(self, busy: bool) -> dict[str, str]:
        base = os.environ | self._extra_environment
        return ros_environment(base, domain_id=self._domain_id, busy=busy)

    def _signal_until_stopped(self, processes: list[NodeProcess], number: int, patience_s: float) -> None:
        """Signal a node again when a new process of it appears, because one may have been starting."""
        deadline = time.monotonic() + patience_s
        signalled: set[int] = set()
        while time.monotonic() < deadline:
            alive = [process for process in processes if not process.wait_stopped(0)]
            if not alive:
                return
            for process in alive:
                pid = process.pid
                if pid is not None and pid not in signalled:
                    signalled.add(pid)
                    process.signal(number, whole_group=number == signal.SIGKILL)
            alive[0].wait_stopped(0.02)

    def _obituary(self, label: str) -> str:
        process = self.processes[label]
        how = f", last {process.last_exit}" if process.last_exit else ""
        words = [f"  | {line}" for line in process.last_words()]
        return "\n".join([f"{label}: {process.state.value}, {process.starts} starts{how}", *words])

    def _remove_shared_memory(self) -> None:
        """Remove the shared memory of killed nodes, after waiting until young objects cannot be theirs."""
        if shared_memory.remove_stale().young:
            time.sleep(shared_memory.MIN_AGE_S)
            shared_memory.remove_stale()

    def _warn_of_small_shm(self) -> None:
        count = len(self.graph.processes)
        needed = shared_memory.BYTES_PER_PARTICIPANT * (count + 1)
        free = shared_memory.free_bytes()
        if free is not None and free < needed:
            self._say(
                f"-- /dev/shm has {free >> 20} MB free, {count} processes need {needed >> 20} MB: images will be "
                "slow or lost; enlarge it (mount -o remount,size=2G /dev/shm; docker run --shm-size=2g)"
            )

    def _say(self, line: str) -> None:
        # A closed console (`ltm run | head`) does not end the graph; the log files have every line.
        with self._console_lock, contextlib.suppress(OSError):
            self._console(line)
