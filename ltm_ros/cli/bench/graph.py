"""`ltm bench graph`: how many frames a site's whole graph finishes on this machine, and what becomes of the others."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer


def graph(
    cameras: Annotated[str, typer.Option(help="Numbers of cameras, with commas.")] = "2",
    rates: Annotated[str, typer.Option(help="Frames a second of each camera, with commas.")] = "0.5,3",
    seconds: Annotated[float, typer.Option(help="Length of each run.", min=2)] = 30.0,
    fusion: Annotated[bool, typer.Option(help="Fuse traced depth with a network's.")] = True,
    domain: Annotated[int | None, typer.Option(min=0, max=232, help="ROS domain.")] = None,
    json: Annotated[Path | None, typer.Option(help="Write the figures here.")] = None,
) -> None:
    """Send the demo's 1080p frames from simulated cameras into the real graph, and count what comes out of it."""
    import json as json_module

    from rich.console import Console
    from rich.table import Table

    from ltm_core.bench.measure import conditions
    from ltm_ros.bench.graph import GraphResult, run_graph
    from ltm_ros.cli.bench.network import numbers

    console = Console()
    counts, offered = [round(value) for value in numbers(cameras)], numbers(rates)
    state = conditions(("numpy", "numba", "onnxruntime", "ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp"))
    load = " ".join(f"{v:.2f}" for v in state.load_average)
    console.print(f"{state.cpu}, {state.cores} cores, load average {load}, Python {state.python}, ", end="")
    console.print(", ".join(f"{name} {number}" for name, number in state.versions.items()))
    results = []
    for count in counts:
        for rate in offered:
            with console.status(f"{count} cameras, {rate:g} frames a second each"):
                results.append(run_graph(count, rate, seconds, fusion, domain))
    table = Table(
        title=f"the demo's frames, 1080p, {'with' if fusion else 'without'} fusion, {seconds:g} s a run",
        caption="finished: labelled, traced, fused with its labels, voted and stored; latency: from stamp to the map's "
        "update, and to fused depth of the slowest camera",
        show_header=False,
    )
    rows: dict[str, Callable[[GraphResult], object]] = {
        "cameras": lambda r: r.cameras,
        "frames a second, offered by each": lambda r: f"{r.offered_hz:g}",
        "frames offered": lambda r: r.offered,
        "admitted": lambda r: r.admitted,
        "finished": lambda r: r.finished,
        "shed": lambda r: r.shed,
        "neither": lambda r: r.lost,
        "fused without labels": lambda r: r.unlabelled,
        "finished of the camera with fewest": lambda r: r.least_finished,
        "finished a second, of all": lambda r: f"{r.finished / r.seconds:.2f}",
        "latency p50, s": lambda r: f"{r.latency_p50_s:.2f}",
        "latency p95, s": lambda r: f"{r.latency_p95_s:.2f}",
        "latency p99, s": lambda r: f"{r.latency_p99_s:.2f}",
        "to fused depth p50, s": lambda r: "" if r.fused_p50_s is None else f"{r.fused_p50_s:.2f}",
        "to fused depth p95, s": lambda r: "" if r.fused_p95_s is None else f"{r.fused_p95_s:.2f}",
        "processor, ms a finished frame": lambda r: f"{r.cpu_ms_a_frame['all']:.0f}",
        "load average before": lambda r: f"{r.load_average:.1f}",
        "cameras late by at most, s": lambda r: f"{r.cameras_late_s:.2f}",
    }
    table.add_column("")
    for _ in results:
        table.add_column(justify="right")
    for name, value in rows.items():
        table.add_row(name, *(str(value(result)) for result in results))
    console.print(table)
    if json is not None:
        json.parent.mkdir(parents=True, exist_ok=True)
        report = {"conditions": state.as_dict(), "runs": [r.as_dict() for r in results]}
        json.write_text(json_module.dumps(report, indent=2))
