"""`ltm run` on the site as a process of its own, and all processes that belong to it."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path

from ltm_core.site.site_io import load_site
from ltm_ros.launching.graph import CAMERAS_MODULE, CAMERAS_PROCESS, Graph, describe
from ltm_ros.runtime.ros_environment import ros_environment

RUNNER = "runner"
LAST_MOMENTS_S = 2.0
"""That a process has, which ends with the runner and is not waited for by it: Python's own resource tracker."""
_MARK = "LTM_CHAOS_RUN"
_NODE = re.compile(r"__ns:=/[^/ ]+(/[^ ]+)? -r __node:=(\S+)")


class RunningSite:
    """Processes are recognised by a mark in the environment that they inherit, whatever their parent is by then."""

    def __init__(self, site: Path, state: Path, recording: Path | None, logs: Path, domain: int) -> None:
        self._command = [sys.executable, "-m", "ltm_ros.cli.main", "run", str(site), "--domain", str(domain)]
        self._command += ["--state", str(state)]
        self._command += [] if recording is None else ["--record", str(recording)]
        self._logs = logs
        self._mark = uuid.uuid4().hex
        self.environment = ros_environment(domain_id=domain)
        """Of processes in the same domain."""
        self._process: subprocess.Popen[bytes] | None = None
        self.starts = 0
        self.left: list[str] = []
        """Labels of processes that were still there after the runner had stopped."""
        self.nodes = tuple(spec.label for spec in self._graph(site, recording).processes)
        """Labels of the processes of all nodes."""

    @staticmethod
    def _graph(site: Path, recording: Path | None) -> Graph:
        return describe(load_site(site), site, record=None if recording is None else {"bag": str(recording)})

    @property
    def console(self) -> Path:
        return self._logs / "console.log"

    def start(self) -> None:
        self._logs.mkdir(parents=True, exist_ok=True)
        with self.console.open("ab") as console:
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=subprocess.STDOUT,
                env=self.environment | {_MARK: self._mark},
                start_new_session=True,
            )
        self.starts += 1

    def stop(self, patience_s: float = 60.0) -> int:
        """In order: SIGTERM to the runner; its exit status."""
        assert self._process is not None
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGTERM)
        try:
            return self._process.wait(patience_s)
        finally:
            self.left = self.wait_gone(LAST_MOMENTS_S)
            for pid in self.processes().values():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)

    def kill_runner(self) -> None:
        assert self._process is not None
        self._process.kill()
        self._process.wait()

    def processes(self) -> dict[str, int]:
        """Process ids by label: `tower/depth`, `fuel_map`, `runner`; others by their module."""
        found: dict[str, int] = {}
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                environment = (folder / "environ").read_bytes().split(b"\0")
                command = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
                zombie = (folder / "stat").read_text().rpartition(")")[2].split()[0] == "Z"
            except OSError:
                continue
            if f"{_MARK}={self._mark}".encode() in environment and command and not zombie:
                found[self._label(int(folder.name), command)] = int(folder.name)
        return found

    def wait_gone(self, patience_s: float) -> list[str]:
        """Labels of the processes that are still there after so long; empty as soon as there are none."""
        deadline = time.monotonic() + patience_s
        while (left := list(self.processes())) and time.monotonic() < deadline:
            time.sleep(0.1)
        return left

    def _label(self, pid: int, command: str) -> str:
        if self._process is not None and pid == self._process.pid:
            return RUNNER
        if node := _NODE.search(command):
            return f"{node[1][1:]}/{node[2]}" if node[1] else node[2]
        if CAMERAS_MODULE in command:
            return CAMERAS_PROCESS
        module = re.search(r"-m ltm_ros\.\S*?(\w+)(?: |$)", command)
        return module[1] if module else f"{Path(command.split()[0]).name}.{pid}"
