"""`ltm-lab bench graph`: throughput, latency, processor time and memory of a whole site graph on this machine."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_lab.cli.bench.runs import numbers, print_conditions, print_table, write_json
from ltm_lab.options import JsonFile

if TYPE_CHECKING:
    from ltm_lab.bench.graph import GraphResult
    from ltm_lab.bench.graph_site import Layout


def graph(
    cameras: Annotated[str, typer.Option(help="Numbers of cameras.")] = "2",
    rates: Annotated[str, typer.Option(help="Frames per second of each camera.")] = "0.5,3",
    seconds: Annotated[float, typer.Option(help="Length of each run, s.", min=2)] = 30.0,
    fusion: Annotated[bool, typer.Option(help="Fuse traced depth with a network's.")] = True,
    processes: Annotated[str, typer.Option(help="Layouts of the site file: site, node.")] = "",
    fixed: Annotated[bool, typer.Option("--fixed", help="Keep the cameras still. Default: they turn.")] = False,
    dem: Annotated[int | None, typer.Option(help="Cells per side of a resampled DEM.", min=100)] = None,
    domain: Annotated[int | None, typer.Option(min=0, max=232, help="ROS domain.")] = None,
    json_path: JsonFile = None,
) -> None:
    """Send the demo's 1080p frames from simulated cameras into a real graph and measure what it finishes.

    Separate several cameras, rates or layouts with commas; each combination is a run.
    """
    from rich.console import Console

    from ltm_lab.bench.graph import run_graph
    from ltm_lab.bench.graph_site import Load
    from ltm_lab.bench.measure import conditions

    console = Console()
    layouts = _layouts(processes)
    counts, offered = [round(value) for value in numbers(cameras)], numbers(rates)
    state = conditions(("numpy", "numba", "onnxruntime", "ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp"))
    print_conditions(console, state)
    results = []
    for count in counts:
        for rate in offered:
            for layout in layouts:
                with console.status(f"{count} cameras, {rate:g} frames per second each"):
                    load = Load(count, fusion, layout, not fixed, dem)
                    results.append(run_graph(load, rate, seconds, domain))
    print_table(
        console,
        f"the demo's frames, {'with' if fusion else 'without'} fusion, {seconds:g} s per run",
        ("", *(f"run {number}" for number, _ in enumerate(results, start=1))),
        [(name, *(value(result) for result in results)) for name, value in _rows(results).items()],
        "finished: labelled, traced, fused with labels, voted and stored; latency: from stamp to the map's update",
    )
    write_json(json_path, state, runs=[result.as_dict() for result in results])


def _rows(results: "list[GraphResult]") -> "dict[str, Callable[[GraphResult], object]]":
    """Return the rows of the table by name."""
    jobs = dict.fromkeys(job for result in results for job in result.cpu_ms_a_frame if job != "all")
    return {
        "processes": lambda r: r.processes,
        "cameras": lambda r: f"{r.cameras}, {'turning' if r.patrol else 'fixed'}",
        "cells of the DEM": lambda r: r.dem_cells,
        "frames per second of each camera": lambda r: f"{r.offered_hz:g}",
        "frames offered": lambda r: r.offered,
        "admitted": lambda r: r.admitted,
        "finished": lambda r: r.finished,
        "shed": lambda r: r.shed,
        "lost": lambda r: r.lost,
        "fused without labels": lambda r: r.unlabelled,
        "finished of the camera with the fewest": lambda r: r.least_finished,
        "finished per second": lambda r: f"{r.finished / r.seconds:.2f}",
        "latency p50, p95, p99, s": lambda r: f"{r.latency_p50_s:.2f}, {r.latency_p95_s:.2f}, {r.latency_p99_s:.2f}",
        "processor time per finished frame, ms": lambda r: f"{r.cpu_ms_a_frame['all']:.0f}",
        **{f"  {job}": partial(_job_ms, job) for job in jobs},
        "processor time per idle second, ms": lambda r: f"{r.idle_cpu_ms_s:.0f}",
        "memory (PSS) of the cameras' nodes, MB": lambda r: f"{r.pss_mb['cameras']:.0f}",
        "memory (PSS) of all processes, MB": lambda r: f"{r.pss_mb['all']:.0f}",
        "until all nodes were ready, s": lambda r: f"{r.ready_s:.1f}",
        "load average before": lambda r: f"{r.load_average:.1f}",
        "largest delay of the simulated cameras, s": lambda r: f"{r.cameras_late_s:.2f}",
    }


def _job_ms(job: str, result: "GraphResult") -> str:
    return f"{result.cpu_ms_a_frame.get(job, 0.0):.1f}"


def _layouts(text: str) -> "list[Layout | None]":
    """Return the requested layouts, or the default alone. Raises BadParameter."""
    known: dict[str, Layout] = {"site": "site", "node": "node"}
    wanted = [part.strip() for part in text.split(",") if part.strip()]
    if any(part not in known for part in wanted):
        raise typer.BadParameter(f"unknown layout in {text!r}; give site, node, or both with a comma")
    return [known[part] for part in wanted] or [None]
