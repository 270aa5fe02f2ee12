"""`ltm-lab bench network`: how many towers one fuel map node can serve."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import typer

from ltm_lab.cli.bench.runs import numbers, print_conditions, runs_table, write_runs
from ltm_ros.cli.output import JsonFile


def network(
    towers: Annotated[str, typer.Option(help="Numbers of towers, with commas.")] = "1,10,100",
    rates: Annotated[str, typer.Option(help="Frames a second of all towers together, with commas.")] = "40",
    seconds: Annotated[float, typer.Option(help="Length of each run.", min=2)] = 30.0,
    extent: Annotated[float, typer.Option(help="Side of the region, metres.", min=2000)] = 10_000.0,
    views: Annotated[int, typer.Option(help="Headings of each tower.", min=1)] = 3,
    domain: Annotated[int | None, typer.Option(min=0, max=232, help="ROS domain.")] = None,
    json_path: JsonFile = None,
) -> None:
    """Send votes of simulated towers through DDS into one fuel map that keeps them, and measure it."""
    from rich.console import Console

    from ltm_lab.bench.measure import conditions
    from ltm_lab.bench.network import NetworkResult, as_dict, run_network

    console = Console()
    counts, offered = [round(value) for value in numbers(towers)], numbers(rates)
    state = conditions(("numpy", "numba", "scipy", "ros-jazzy-rclpy", "ros-jazzy-rmw-fastrtps-cpp", "zstandard"))
    print_conditions(console, state)
    results = []
    for count in counts:
        for rate in offered:
            with console.status(f"{count} towers, {rate:g} frames a second"):
                results.append(run_network(count, rate, seconds, extent, views, domain))
            last = results[-1]
            console.print(
                f"{count} towers: {last.sustained_hz:.1f} Hz, {last.lost} lost, p95 {last.latency_p95_s:.2f} s"
            )
    title = f"one fuel map of {extent / 1000:g} x {extent / 1000:g} km, {seconds:g} s a run, evidence on disk"
    caption = "latency: from stamp to update, once it is stored; lost: not told of, or not there after a kill"
    rows: dict[str, Callable[[NetworkResult], object]] = {
        "towers": lambda r: r.towers,
        "frames a second, offered": lambda r: f"{r.offered_hz:.1f}",
        "frames a second, told of": lambda r: f"{r.sustained_hz:.1f}",
        "frames sent": lambda r: r.sent,
        "frames lost": lambda r: r.lost,
        "latency p50, s": lambda r: f"{r.latency_p50_s:.2f}",
        "latency p95, s": lambda r: f"{r.latency_p95_s:.2f}",
        "latency at most, s": lambda r: f"{r.latency_max_s:.2f}",
        "processor, cores": lambda r: f"{r.cpu_cores:.2f}",
        "processor, ms a frame": lambda r: f"{r.cpu_ms_a_frame:.1f}",
        "memory, MB": lambda r: f"{r.memory_mb:.0f}",
        "store, MB": lambda r: f"{r.store_mb:.1f}",
        "opens after a kill in, s": lambda r: f"{r.open_s:.2f}",
        "cells a frame": lambda r: f"{r.cells_a_frame:.0f}",
        "kB a frame": lambda r: f"{r.bytes_a_frame / 1e3:.1f}",
        "towers late by at most, s": lambda r: f"{r.towers_late_s:.2f}",
    }
    console.print(runs_table(title, caption, rows, results))
    for r in results:
        if r.dropped:
            console.print(f"{r.towers} towers at {r.offered_hz:g} Hz dropped {r.dropped}")
    if json_path is not None:
        write_runs(json_path, state, [as_dict(r) for r in results])
