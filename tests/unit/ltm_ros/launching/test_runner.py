"""The runner of a graph, without ROS."""

from __future__ import annotations

import errno
import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from ltm_ros.launching import runner as runner_module
from ltm_ros.launching.graph import Graph, NodeSpec
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.process_memory import Trimming


def run_idle_graph(folder: Path, console: Callable[[str], None]) -> None:
    """Run a node that does nothing until this process is told to end, which it is after a minute at the latest."""
    (folder / "idle_node.py").write_text("import time\ntime.sleep(600)\n")
    graph = Graph("ridge", (NodeSpec("idle", "/ridge", "idle_node"),))
    runner = Runner(graph, log_folder=folder, console=console, environment={"PYTHONPATH": str(folder)})
    patience = threading.Timer(60.0, os.kill, (os.getpid(), signal.SIGTERM))
    patience.start()
    try:
        assert runner.run() == 0
    finally:
        patience.cancel()


def test_a_machine_without_room_for_another_process_is_asked_again_what_is_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else nobody would ever tell the service manager that the graph is up, nor would its watchdog begin."""
    lines: list[str] = []
    tries: list[object] = []

    def refuse(*command: object) -> None:
        tries.append(command)
        if len(tries) == 3:
            os.kill(os.getpid(), signal.SIGTERM)
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr(runner_module, "start_supervised", refuse)
    run_idle_graph(tmp_path, lines.append)
    assert len(tries) >= 3
    assert [line for line in lines if os.strerror(errno.EAGAIN) in line] == [
        f"-- {OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))}"
    ]


def test_the_runner_trims_its_own_heap_as_nodes_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It lives as long as its nodes, and grew by a page a minute."""
    looks: list[float] = []

    class Watched(Trimming):
        def look(self, now_s: float) -> None:
            looks.append(now_s)
            if len(looks) == 3:
                os.kill(os.getpid(), signal.SIGTERM)

    def refuse(*command: object) -> None:
        raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN))

    monkeypatch.setattr(runner_module, "start_supervised", refuse)
    monkeypatch.setattr(runner_module, "Trimming", Watched)
    run_idle_graph(tmp_path, lambda line: None)
    assert len(looks) >= 3
    assert looks == sorted(looks)
