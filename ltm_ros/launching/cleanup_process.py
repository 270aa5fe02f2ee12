"""Start the processes of a graph, and the one that cleans up after them."""

from __future__ import annotations

import os
import signal
import subprocess  # nosec B404 # argument lists, no shell
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

from ltm_ros.launching.graph import CAMERAS_MODULE, ProcessSpec, nodes_json, parameters_yaml
from ltm_ros.launching.supervised import supervised_command

_QUIET = ("--disable-external-lib-logs",)
"""We keep a node's output; ROS's own log files in ~/.ros would grow without limit."""


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


AGAIN_S = 0.5
"""Delay in seconds before a dead cleanup process is restarted."""
PATIENCE_S = 10.0


class CleanupProcess:
    """Keeps a cleanup process running; a new one gets the full list. `tell` takes messages for the runner's user."""

    def __init__(self, environment: Callable[[], Mapping[str, str]], tell: Callable[[str], None]) -> None:
        self._environment, self._tell = environment, tell
        self._lock = threading.Lock()
        self._listed: dict[str, None] = {}
        self._process: subprocess.Popen[bytes] | None = None
        self._orders: int | None = None
        """The write end of its pipe, if it runs."""
        self._stopping = threading.Event()
        # One thread for its whole life: Linux signals a process when the thread that started it ends.
        self._thread = threading.Thread(target=self._keep, name="orphan cleanup", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def group(self, group: int, alive: bool) -> None:
        """Report that a process group was created or has ended."""
        self._list(f"group {group}", alive, f"forget {group}")

    def folder(self, path: os.PathLike[str], exists: bool) -> None:
        """Report that a temporary folder was created or removed."""
        self._list(f"folder {path}", exists, f"forget-folder {path}")

    def stop(self) -> None:
        """End the process; it first ends and removes everything that is still listed. Idempotent."""
        self._stopping.set()
        with self._lock:
            process = self._process
            self._close_pipe()
            if process is not None:
                process.send_signal(signal.SIGCONT)
        if self._thread.ident is not None:
            self._thread.join(PATIENCE_S)
            if self._thread.is_alive() and process is not None:
                process.kill()
                self._thread.join()

    def _list(self, order: str, exists: bool, forget: str) -> None:
        with self._lock:
            if exists:
                self._listed[order] = None
            else:
                self._listed.pop(order, None)
            self._send(order if exists else forget)

    def _send(self, order: str) -> None:
        if self._orders is None:
            return
        try:
            os.write(self._orders, order.encode() + b"\n")
        except BlockingIOError:
            if self._process is not None:
                self._process.kill()  # it does not read; its successor gets the full list
        except BrokenPipeError:
            return

    def _close_pipe(self) -> None:
        if self._orders is not None:
            os.close(self._orders)
            self._orders = None

    def _keep(self) -> None:
        while not self._stopping.is_set():
            try:
                status = self._run_once()
            except OSError as error:
                self._tell(f"-- the cleanup process cannot be started: {error}")
            else:
                if not self._stopping.is_set():
                    self._tell(f"-- the cleanup process died (status {status}); restarting it")
            self._stopping.wait(AGAIN_S)

    def _run_once(self) -> int:
        """Start the process, send it the list, and wait for its end; return its exit status."""
        with self._lock:
            if self._stopping.is_set():
                return 0
            read, self._orders = os.pipe()
            os.set_blocking(self._orders, False)
            # Sent before it can read, so that a killed runner leaves no uninformed cleanup process. The pipe takes 64
            # kB, more than the list of all processes and folders of a graph.
            for order in self._listed:
                self._send(order)
            try:
                process = self._process = self._start(read)
            except OSError:
                self._close_pipe()
                raise
            finally:
                os.close(read)
        status = process.wait()
        with self._lock:
            self._process = None
            self._close_pipe()
        return status

    def _start(self, orders: int) -> subprocess.Popen[bytes]:
        return subprocess.Popen(  # nosec B603 # no shell, no argument from the wire
            [sys.executable, "-m", "ltm_ros.launching.orphan_cleanup"],
            stdin=orders,
            stdout=subprocess.DEVNULL,
            env=self._environment(),
            start_new_session=True,
        )
