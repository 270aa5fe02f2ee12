"""`ltm-lab bench kills`: how much is lost, and for how long, where a process of a site's graph is killed under load."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_lab.cli.bench.runs import print_conditions, runs_table, write_runs
from ltm_ros.cli.output import JsonFile

if TYPE_CHECKING:
    from ltm_lab.bench.graph_kills import KillsResult


def kills(
    cameras: Annotated[int, typer.Option(help="Number of cameras.", min=1, max=100)] = 2,
    rate: Annotated[float, typer.Option(help="Frames a second of each camera.", min=0.01)] = 2.0,
    times: Annotated[int, typer.Option(help="How often each process is killed.", min=1)] = 10,
    domain: Annotated[int | None, typer.Option(min=0, max=232, help="ROS domain.")] = None,
    json_path: JsonFile = None,
) -> None:
    """Kill each process of the real graph under load, with SIGKILL, and tell what became of every frame.

    The graph is the demo's with fusion, terrain and a recorder. Exits with 1 where more frames are missing than were at
    work or on their way to a dead process, or were shed.
    """
    from rich.console import Console

    from ltm_lab.bench.graph_kills import run_kills
    from ltm_lab.bench.graph_site import Load
    from ltm_lab.bench.measure import conditions

    console = Console()
    state = conditions(("numpy", "numba", "onnxruntime", "ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp"))
    print_conditions(console, state)
    results = run_kills(Load(cameras, terrain=True), rate, times, domain, lambda line: console.print(f"-- {line}"))
    rows: dict[str, Callable[[KillsResult], object]] = {
        "process": lambda r: r.process,
        "killed": lambda r: r.kills,
        "frames sent": lambda r: r.sent,
        "in the map": lambda r: r.frames.stored,
        "at work when it was killed": lambda r: r.frames.in_flight,
        "sent while it was away": lambda r: r.frames.away,
        "missing otherwise": lambda r: r.frames.otherwise,
        "shed, as told": lambda r: r.shed,
        "all cameras back, median, s": lambda r: f"{r.back_median_s:.1f}",
        "all cameras back, at most, s": lambda r: f"{r.back_most_s:.1f}",
    }
    title = f"{cameras} cameras, {rate:g} frames a second each, fusion, terrain, recorder"
    console.print(runs_table(title, "back: the map tells of a frame from after the kill", rows, results))
    if json_path is not None:
        write_runs(json_path, state, [r.as_dict() for r in results])
    if any(r.frames.otherwise > r.shed for r in results):
        raise typer.Exit(1)
