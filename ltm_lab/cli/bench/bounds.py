"""`ltm-lab bench bounds`: the memory of the largest messages that are taken, and the time in which larger are dropped."""

from __future__ import annotations

from ltm_lab.cli.bench.runs import print_conditions, write_runs
from ltm_ros.cli.output import JsonFile


def bounds(json_path: JsonFile = None) -> None:
    """Give each node frames of as many pixels as `limits` allows, and those that cameras talk to larger ones."""
    import tempfile
    from dataclasses import asdict
    from pathlib import Path

    from rich.console import Console

    from ltm_core.site.sections import MessageLimits
    from ltm_lab.bench.measure import conditions
    from ltm_lab.bench.message_bounds import dropped, largest_camera, nodes_at_bound

    console = Console()
    state = conditions(("numpy", "numba", "onnxruntime", "opencv-python-headless"))
    print_conditions(console, state)
    camera = largest_camera(MessageLimits())
    console.print(f"frames of {camera.width:,} x {camera.height:,}; each node in a process of its own, without DDS")
    console.print("most memory: when ready, and with frames")
    runs = []
    with tempfile.TemporaryDirectory(prefix="ltm-bounds-") as own, console.status("") as status:
        for use in nodes_at_bound(Path(own), status.update):
            runs.append(asdict(use))
            console.print(f"{use.ready_mb:6,.0f} {use.most_mb:8,.0f} MB  {use.node}", highlight=False)
        console.print("beyond a bound: processor time until it is dropped, and growth of the process")
        status.update("larger messages")
        for drop in dropped(Path(own)):
            runs.append(asdict(drop))
            console.print(
                f"{drop.cpu_ms:6.1f} ms {drop.grown_mb:6.1f} MB  {drop.node}: {drop.message} ({drop.cause})",
                highlight=False,
            )
    if json_path is not None:
        write_runs(json_path, state, runs)
