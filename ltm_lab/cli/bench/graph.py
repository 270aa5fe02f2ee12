"""`ltm-lab bench graph`: how many frames a site's whole graph finishes on this machine, and what becomes of the others."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_lab.cli.bench.runs import numbers, print_conditions, runs_table, write_runs
from ltm_ros.cli.output import JsonFile

if TYPE_CHECKING:
    from ltm_lab.bench.graph_site import Layout


def graph(
    cameras: Annotated[str, typer.Option(help="Numbers of cameras, with commas.")] = "2",
    rates: Annotated[str, typer.Option(help="Frames a second of each camera, with commas.")] = "0.5,3",
    seconds: Annotated[float, typer.Option(help="Length of each run.", min=2)] = 30.0,
    fusion: Annotated[bool, typer.Option(help="Fuse traced depth with a network's.")] = True,
    processes: Annotated[str, typer.Option(help="Layouts, as in a site file, with commas: site, node.")] = "",
    fixed: Annotated[bool, typer.Option("--fixed", help="Cameras that stand still; the demo's towers turn.")] = False,
    width: Annotated[int, typer.Option(help="Width of the photos; 3840: the demo's, enlarged to 4K.", min=64)] = 1920,
    dem: Annotated[
        int | None, typer.Option(help="Cells a side of the DEM: the demo's, resampled. Default: as it is.", min=100)
    ] = None,
    view: Annotated[
        bool, typer.Option("--view", help="With the live view of `ltm run --view`, and somebody who looks at it.")
    ] = False,
    domain: Annotated[int | None, typer.Option(min=0, max=232, help="ROS domain.")] = None,
    json_path: JsonFile = None,
) -> None:
    """Send the demo's 1080p frames from simulated cameras into the real graph, and count what comes out of it."""
    from rich.console import Console

    from ltm_lab.bench.graph import GraphResult, run_graph
    from ltm_lab.bench.graph_site import Load
    from ltm_lab.bench.graph_view import SERVER, VIEWER, Onlooker
    from ltm_lab.bench.growth import SUM
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
                with console.status(f"{count} cameras, {rate:g} frames a second each"):
                    load = Load(count, fusion, layout, not fixed, width, dem)
                    results.append(run_graph(load, rate, seconds, domain, Onlooker() if view else None))
    title = f"the demo's frames, {width} px wide, {'with' if fusion else 'without'} fusion, {seconds:g} s a run"
    caption = (
        "finished: labelled, traced, fused with its labels, voted and stored; latency: from stamp to the map's update, "
        "and to fused depth of the slowest camera"
    )
    rows: dict[str, Callable[[GraphResult], object]] = {
        "processes": lambda r: r.processes,
        "cameras": lambda r: f"{r.cameras}, {'turning' if r.patrol else 'fixed'}",
        "cells of the DEM": lambda r: r.dem_cells,
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
        "idle, processor ms a second": lambda r: f"{r.idle_cpu_ms_s:.0f}",
        "memory (PSS) of the cameras' nodes, MB": lambda r: f"{r.pss_mb['cameras']:.0f}",
        "memory (PSS) of all, MB": lambda r: f"{r.pss_mb['all']:.0f}",
        "grown meanwhile: memory, MB": lambda r: f"{r.grown_pss_mb:.0f}",
        "grown meanwhile: descriptors, threads": lambda r: f"{r.grown_descriptors}, {r.grown_threads}",
        "second half: memory, kB a minute": lambda r: f"{r.held_more.memory[SUM].slope:.0f}",
        "second half: memory, kB": lambda r: f"{r.held_more.memory[SUM].grown:.0f}",
        "second half: descriptors, threads, /dev/shm": lambda r: (
            f"{r.held_more.descriptors}, {r.held_more.threads}, {r.held_more.shared_objects}"
        ),
        "second half: files of the map, kB": lambda r: f"{r.held_more.kept_bytes / 1024:.0f}",
        "cells of the map that frames have touched": lambda r: f"{r.seen_cells[0]} to {r.seen_cells[1]}",
        "until all nodes were up, s": lambda r: f"{r.ready_s:.1f}",
        "load average before": lambda r: f"{r.load_average:.1f}",
        "cameras late by at most, s": lambda r: f"{r.cameras_late_s:.2f}",
    }
    if view:
        rows |= {
            "live view and its server: at most, last, MB": lambda r: (
                f"{r.view.most_mb:.0f}, {r.view.last_mb:.0f}" if r.view else ""
            ),
            "of it the server at most, MB": lambda r: f"{r.view.server_most_mb:.0f}" if r.view else "",
            "second half: viewer, server, kB a minute": lambda r: ", ".join(
                f"{r.held_more.memory[label].slope:.0f}" for label in (VIEWER, SERVER) if label in r.held_more.memory
            ),
            "sent to who looked on, MB": lambda r: f"{r.view.taken_mb:.0f}" if r.view else "",
        }
    console.print(runs_table(title, caption, rows, results))
    if json_path is not None:
        write_runs(json_path, state, [r.as_dict() for r in results])


def _layouts(text: str) -> list[Layout | None]:
    """Raises BadParameter for what is none."""
    known: dict[str, Layout] = {"site": "site", "node": "node"}
    wanted = [part.strip() for part in text.split(",") if part.strip()]
    if any(part not in known for part in wanted):
        raise typer.BadParameter(f"give site, node, or both with a comma, got {text!r}")
    return [known[part] for part in wanted] or [None]
