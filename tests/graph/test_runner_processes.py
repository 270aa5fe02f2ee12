import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from leftovers import owned_by_process, processes_of_domain, segments, wait_gone
from scenes.waiting import wait_for

from ltm_ros.launching import shared_memory
from ltm_ros.launching.graph import Graph, NodeSpec
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.supervisor import Console, RestartPolicy

pytestmark = pytest.mark.graph

HERE = Path(__file__).parent
QUICK = RestartPolicy(initial_s=0.1, maximum_s=0.4, config_tries=2)


def spec(name: str, camera: str = "north", behaviour: str = "well") -> NodeSpec:
    return NodeSpec(name, f"/ridge/{camera}", "nodes_for_tests", {"behaviour": behaviour, "title": "on"})


class Started:
    """A runner with its console's lines."""

    def __init__(self, domain: int, *nodes: NodeSpec, stop_s: float = 5.0, console: Console | None = None) -> None:
        self.lines: list[str] = []
        self.runner = Runner(
            Graph("ridge", nodes),
            domain_id=domain,
            console=console or self.lines.append,
            policy=QUICK,
            stop_s=stop_s,
        )
        self.runner.start()

    def wait_for(self, condition: Callable[[], object], what: str) -> None:
        wait_for(condition, what, lambda: "\n".join(self.lines))


@pytest.fixture
def start(ros_domain: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Started]]:
    monkeypatch.setenv("PYTHONPATH", str(HERE))
    started: list[Started] = []

    def start(*nodes: NodeSpec, stop_s: float = 5.0, console: Console | None = None) -> Started:
        started.append(Started(ros_domain, *nodes, stop_s=stop_s, console=console))
        return started[-1]

    yield start
    for one in started:
        one.runner.stop()


def test_comes_up_and_stops_in_order(start: Callable[..., Started]) -> None:
    graph = start(spec("depth"), spec("capture", "south"), spec("depth", "south"))
    graph.runner.wait_until_ready(30)
    pids = {label: process.pid for label, process in graph.runner.processes.items()}
    assert list(pids) == ["north/depth", "south/capture", "south/depth"]
    assert len({*pids.values()}) == 3
    graph.runner.stop()
    for label, process in graph.runner.processes.items():
        assert (process.running, process.starts) == (False, 1)
        # Each line bears its node's label.
        hello = f"hello from /ridge/{label} pid {pids[label]}"
        assert f"[{label}] {hello}" in graph.lines
        assert f"[{label}] goodbye" in graph.lines


def test_ends_a_node_that_will_not_stop(start: Callable[..., Started]) -> None:
    graph = start(spec("depth", behaviour="stubborn"), spec("capture"), stop_s=3.0)
    graph.runner.wait_until_ready(30)
    pid = graph.runner.processes["north/depth"].pid
    assert pid is not None
    owned = segments(owned_by_process(pid))
    assert owned
    graph.runner.stop()
    assert any("SIGKILL to north/depth, still running" in line for line in graph.lines), graph.lines
    assert "[north/capture] goodbye" in graph.lines
    # Another test's runner may be about to remove them just now.
    assert wait_gone(lambda: [name for name in owned if os.path.lexists(shared_memory.SHM_FOLDER / name)]) == []


RUN = """
import os, sys
sys.path[:0] = [sys.argv[1], sys.argv[1] + "/.."]
from test_runner_processes import HERE, QUICK, spec
from ltm_ros.launching.graph import Graph
from ltm_ros.launching.runner import Runner
nodes = (spec("depth"), spec("capture"), spec("viewer", behaviour="stubborn"))[: int(sys.argv[2])]
os.environ["PYTHONPATH"] = str(HERE)
runner = Runner(Graph("ridge", nodes), policy=QUICK)
sys.exit(runner.run())
"""


def _run_in_process(nodes: int, pids: dict[str, int]) -> subprocess.Popen[str]:
    """`Runner.run` in a process of its own, once all its nodes have said hello; fills in their process ids."""
    runner = subprocess.Popen([sys.executable, "-c", RUN, str(HERE), str(nodes)], stdout=subprocess.PIPE, text=True)
    for line in runner.stdout:
        if found := re.search(r"hello from (\S+) pid (\d+)", line):
            pids[found[1]] = int(found[2])
        if len(pids) == nodes:
            break
    return runner


def test_signal_to_the_runner_ends_everything(ros_domain: int) -> None:
    pids: dict[str, int] = {}
    runner = _run_in_process(2, pids)
    # Only lines of the runner itself have no label.
    assert next(line for line in runner.stdout if line.startswith("--")) == "-- all 2 nodes are ready\n"
    runner.send_signal(signal.SIGINT)
    output, _ = runner.communicate(timeout=30)
    assert runner.returncode == 0
    assert "still running" not in output
    assert processes_of_domain(ros_domain) == []


def test_killed_runner_leaves_no_process_and_the_next_one_removes_its_shared_memory(ros_domain: int) -> None:
    pids: dict[str, int] = {}
    runner = _run_in_process(2, pids)
    owned = segments(set().union(*map(owned_by_process, pids.values())))
    assert len(owned) >= 2
    os.kill(pids["/ridge/north/depth"], signal.SIGSTOP)  # it goes on when the runner ends
    runner.kill()
    runner.communicate()
    assert wait_gone(lambda: processes_of_domain(ros_domain), patience_s=30.0) == []
    wait_for(lambda: not shared_memory.remove_stale(), "what is left to be old enough")
    assert [name for name in owned if os.path.lexists(shared_memory.SHM_FOLDER / name)] == []


def test_a_console_that_is_gone_ends_no_graph(start: Callable[..., Started]) -> None:
    def gone(line: str) -> None:
        raise BrokenPipeError

    graph = start(spec("depth"), console=gone)
    graph.runner.wait_until_ready(30)
    graph.runner.processes["north/depth"].signal(signal.SIGKILL)
    depth = graph.runner.processes["north/depth"]
    graph.wait_for(lambda: depth.starts == 2 and depth.running, "the node again")
    graph.runner.wait_until_ready(30)


def test_a_graph_is_up_without_an_optional_node_that_is_failing(start: Callable[..., Started]) -> None:
    """Else a service would never be ready for want of its status page."""
    viewer = replace(spec("viewer", behaviour="config_error"), required=False)
    graph = start(spec("capture"), viewer)
    graph.runner.wait_until_ready(30)
    graph.wait_for(lambda: graph.runner.failing == ["north/viewer"], "the verdict")
    graph.runner.wait_until_ready(30)


@pytest.mark.parametrize("behaviour", ["slow_to_start", "loses_the_stop"])
def test_stops_a_node_that_takes_long_to_start(start: Callable[..., Started], behaviour: str) -> None:
    graph = start(spec("depth", behaviour=behaviour))
    graph.wait_for(lambda: any("hello" in line for line in graph.lines), "its first line")
    graph.runner.stop()
    # Fast DDS may tell of another graph's port that was being removed as it looked.
    said = [line for line in graph.lines if "RTPS_TRANSPORT_SHM" not in line]
    assert len(said) == 2, graph.lines  # its start and its greeting


def test_signal_while_the_graph_comes_up_ends_everything(ros_domain: int) -> None:
    runner = _run_in_process(1, {})
    runner.terminate()
    output, _ = runner.communicate(timeout=30)
    assert runner.returncode == 0
    assert "nodes are ready" not in output
    assert "not ready" not in output
    assert processes_of_domain(ros_domain) == []
