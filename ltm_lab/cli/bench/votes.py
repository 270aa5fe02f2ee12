"""`ltm-lab bench votes`: the cost of forming a frame's votes, and the size of their message."""

from __future__ import annotations

from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def votes(
    width: Annotated[int, typer.Option(help="Of the depth image, pixels.", min=64)] = 1920,
    height: Annotated[int, typer.Option(help="Of the depth image, pixels.", min=64)] = 1080,
    repeats: Annotated[int, typer.Option(help="Calls that each figure is the least of.", min=1)] = 15,
    cell: Annotated[float, typer.Option(help="Of the fuel grid, metres.", min=1)] = 30.0,
    extent: Annotated[int, typer.Option(help="Side of the mountains that are looked at, metres.", min=1000)] = 5000,
    json_path: JsonFile = None,
) -> None:
    """Form the votes of a frame from several views: processor time, cells, and the size of the message."""
    from rclpy.serialization import serialize_message
    from rich.console import Console
    from rich.table import Table

    from ltm_core.fuel.vote_columns import MAX_BYTES, fitting
    from ltm_core.vision.labels import LabelSet
    from ltm_lab.bench.measure import conditions
    from ltm_lab.bench.votes import REACH, run
    from ltm_lab.evaluation.figures_io import write_figures
    from ltm_msgs_py.pointcloud import votes_to_msg

    console = Console()
    state = conditions(("numpy", "numba", "ros-jazzy-rclpy"))
    with console.status("measuring"):
        costs = run(width, height, repeats, cell, extent)
    names = LabelSet.load().names
    table = Table(
        title=f"votes of a {width} x {height} frame: cells of {cell:g} m out to {REACH:g} m in {extent} m of mountains",
        caption=f"processor: least of {repeats} calls, one thread; message: serialised, at most {MAX_BYTES:,} bytes; "
        "where more cells are seen than fit, the best always go and the others take turns",
    )
    for column in ("view", "processor ms", "wall ms", "pixels on ground", "cells seen", "cells sent", "message, bytes"):
        table.add_column(column, justify="left" if column == "view" else "right", no_wrap=column == "view")
    rows = []
    for one in costs:
        sent = fitting(one.votes, 0)
        size = len(serialize_message(votes_to_msg(sent, names)))
        rows.append(
            {
                "view": one.view.name,
                "cpu_ms": one.cost.cpu_ms,
                "wall_ms": one.cost.wall_ms,
                "ground": one.ground,
                "cells": len(one.votes),
                "sent": len(sent),
                "bytes": size,
            }
        )
        table.add_row(
            f"{one.view.name}, {one.view.hfov_deg:g}°",
            f"{one.cost.cpu_ms:.1f}",
            f"{one.cost.wall_ms:.1f}",
            f"{100 * one.ground:.0f} %",
            f"{len(one.votes):,}",
            f"{len(sent):,}",
            f"{size:,}",
        )
    console.print(table)
    load = " ".join(f"{value:.2f}" for value in state.load_average)
    versions = ", ".join(f"{name} {number}" for name, number in state.versions.items())
    console.print(f"{state.cpu}, {state.cores} cores, load average {load}, Python {state.python}, {versions}")
    if json_path is not None:
        report = {"conditions": state.as_dict(), "width": width, "height": height, "cell": cell, "extent": extent}
        report["views"] = rows
        write_figures(json_path, report)
