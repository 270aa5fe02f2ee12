"""`ltm-lab bench segmentation`: the cost of labelling a photo, and the photos a second of a segmentation node."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from ltm_core.base.types import UInt8Array
from ltm_core.vision.manifest import DEFAULT_DEPTH_MODEL, DEFAULT_MODEL
from ltm_ros.cli.output import JsonFile

if TYPE_CHECKING:
    from ltm_core.depth.monocular import DepthNetwork
    from ltm_core.geometry.camera import Camera
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.bench.measure import Cost


def segmentation(
    model: Annotated[list[str] | None, typer.Option("--model", help="Model name or manifest; again for more.")] = None,
    width: Annotated[int, typer.Option(help="Of the photo, pixels.", min=64)] = 1920,
    height: Annotated[int, typer.Option(help="Of the photo, pixels.", min=64)] = 1080,
    threads: Annotated[str, typer.Option(help="CPU threads of the network, with commas.")] = "1,2",
    depth_model: Annotated[
        str, typer.Option(help="Depth network that is timed beside it, by name or manifest.")
    ] = DEFAULT_DEPTH_MODEL,
    frames: Annotated[int, typer.Option(help="Photos that a node labels.", min=5)] = 40,
    repeats: Annotated[int, typer.Option(help="Calls that each figure is the least of.", min=1)] = 15,
    domain: Annotated[int | None, typer.Option(min=0, max=232, help="ROS domain.")] = None,
    json_path: JsonFile = None,
) -> None:
    """Label one photo: by the function, and by a node that gets it through DDS and publishes labels and confidence."""
    from dataclasses import asdict
    from functools import partial

    from rich.console import Console
    from rich.table import Table

    from ltm_core.depth.monocular import DepthNetwork
    from ltm_core.geometry.camera import Camera
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.bench.measure import conditions, least_cost
    from ltm_lab.bench.segmentation import drawn_landscape, run_segmentation
    from ltm_lab.evaluation.figures_io import write_figures

    console, counts = Console(), [int(part) for part in threads.split(",")]
    state = conditions(("numpy", "onnxruntime", "opencv-python-headless", "ros-jazzy-rclpy"))
    photo, camera = drawn_landscape(height, width), Camera.from_fov(width, height, 60.0)
    rows = []
    for name in model or [DEFAULT_MODEL]:
        for count in counts:
            with console.status(f"{name}, {count} threads"):
                segmenter = Segmenter.open(name, count)
                segmenter.segment(photo)
                cost = least_cost(partial(segmenter.segment, photo), repeats)
                # Opened now and let go: a file that gives both computes depth for whoever has it open.
                both = _of_both(segmenter, DepthNetwork.open(depth_model, count), photo, camera, repeats)
                rate = run_segmentation(name, count, photo, frames, domain)
            rows.append((name, count, cost, both, rate))
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
    for name, count, cost, _, rate in rows:
        figures = (cost.cpu_ms, cost.wall_ms, rate.cpu_ms, 1e3 / rate.cpu_ms, rate.hz)
        table.add_row(name, str(count), *(f"{value:.1f}" for value in figures))
    console.print(table)
    for name, count, cost, both, _ in rows:
        console.print(
            f"{name} and {depth_model}, {count} threads: {both.cpu_ms:.1f} ms of processor time for labels and depth, "
            f"of which labels alone take {cost.cpu_ms:.1f}",
            highlight=False,
        )
    load = " ".join(f"{value:.2f}" for value in state.load_average)
    versions = ", ".join(f"{name} {number}" for name, number in state.versions.items())
    console.print(f"{state.cpu}, {state.cores} cores, load average {load}, Python {state.python}, {versions}")
    if json_path is not None:
        report = {
            "conditions": state.as_dict(),
            "width": width,
            "height": height,
            "rows": [
                {
                    "model": name,
                    "threads": count,
                    "segment": asdict(cost),
                    "labels_and_depth": asdict(both),
                    "node": asdict(rate),
                }
                for name, count, cost, both, rate in rows
            ],
        }
        write_figures(json_path, report)


def _of_both(segmenter: Segmenter, network: DepthNetwork, photo: UInt8Array, camera: Camera, repeats: int) -> Cost:
    """Labels, then depth of a photo."""
    from ltm_lab.bench.measure import least_cost

    def once() -> None:
        segmenter.segment(photo)
        network.predict(photo, camera)

    once()
    return least_cost(once, repeats)
