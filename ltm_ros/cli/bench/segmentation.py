"""`ltm bench segmentation`: the cost of labelling a photo, and the photos a second of a segmentation node."""

from __future__ import annotations

from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def segmentation(
    model: Annotated[list[str] | None, typer.Option("--model", help="Model name or manifest; again for more.")] = None,
    width: Annotated[int, typer.Option(help="Of the photo, pixels.", min=64)] = 1920,
    height: Annotated[int, typer.Option(help="Of the photo, pixels.", min=64)] = 1080,
    threads: Annotated[str, typer.Option(help="CPU threads of the network, with commas.")] = "1,2",
    frames: Annotated[int, typer.Option(help="Photos that a node labels.", min=5)] = 40,
    repeats: Annotated[int, typer.Option(help="Calls that each figure is the least of.", min=1)] = 15,
    domain: Annotated[int | None, typer.Option(min=0, max=232, help="ROS domain.")] = None,
    json_path: JsonFile = None,
) -> None:
    """Label one photo: by the function, and by a node that gets it through DDS and publishes labels and confidence."""
    from dataclasses import asdict

    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from ltm_core.bench.measure import conditions, least_cost
    from ltm_core.vision.segmenter import DEFAULT_MODEL, Segmenter
    from ltm_ros.bench.segmentation import run_segmentation
    from ltm_ros.evaluation.figures_io import write_figures

    console = Console()
    state = conditions(("numpy", "onnxruntime", "opencv-python-headless", "ros-jazzy-rclpy"))
    photo = np.random.default_rng(0).integers(0, 256, (height, width, 3), dtype=np.uint8)
    rows = []
    for name in model or [DEFAULT_MODEL]:
        for count in [int(part) for part in threads.split(",")]:
            with console.status(f"{name}, {count} threads"):
                segmenter = Segmenter.open(name, count)
                segmenter.segment(photo)
                cost = least_cost(lambda segmenter=segmenter: segmenter.segment(photo), repeats)  # type: ignore[misc]
                rate = run_segmentation(name, count, photo, frames, domain)
            rows.append((name, count, cost, rate))
    table = Table(
        title=f"labels of a {width} x {height} photo",
        caption="call: the least of some in this process. node: a process of its own, photos in and labels out through "
        "DDS; its processor time a photo says how many a second one core gives, whatever else runs",
    )
    table.add_column("model", overflow="fold")
    for column in (
        "threads",
        "call\ncpu ms",
        "call\nwall ms",
        "node\ncpu ms",
        "node, Hz\na core",
        "node, Hz\nby clock",
    ):
        table.add_column(column, justify="right", no_wrap=True)
    for name, count, cost, rate in rows:
        figures = (cost.cpu_ms, cost.wall_ms, rate.cpu_ms, 1e3 / rate.cpu_ms, rate.hz)
        table.add_row(name, str(count), *(f"{value:.1f}" for value in figures))
    console.print(table)
    load = " ".join(f"{value:.2f}" for value in state.load_average)
    versions = ", ".join(f"{name} {number}" for name, number in state.versions.items())
    console.print(f"{state.cpu}, {state.cores} cores, load average {load}, Python {state.python}, {versions}")
    if json_path is not None:
        report = {
            "conditions": state.as_dict(),
            "width": width,
            "height": height,
            "rows": [
                {"model": name, "threads": count, "segment": asdict(cost), "node": asdict(rate)}
                for name, count, cost, rate in rows
            ],
        }
        write_figures(json_path, report)
