"""`ltm-lab eval assessment`: how often the 95 % intervals of `ltm assess report` contain the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def assessment(
    plan: Annotated[
        Path | None, typer.Option(help="Folder of `ltm assess plan` for a rendered map; needs --truth.")
    ] = None,
    truth: Annotated[Path | None, typer.Option(help="GeoTIFF of the rendered map's true life forms.")] = None,
    cells: Annotated[int, typer.Option(min=20, help="Sampled cells.")] = 300,
    samples: Annotated[int, typer.Option(min=10, help="Number of samples.")] = 500,
    json_path: JsonFile = None,
) -> None:
    """Draw samples of maps with known truth, with simulated interpreters, and count intervals that contain the truth.

    An interpreter's errors bias all figures: the interval is of what he would answer in all cells.
    """
    from dataclasses import asdict

    from rich.console import Console

    from ltm_lab.evaluation.assessment_trial import coverage, drawn_population, rendered_population
    from ltm_ros.cli.output import print_table
    from ltm_ros.pages import write_figures

    populations = [
        drawn_population("standard"),
        drawn_population("1 % change", changed=0.01, errors=0.0),
        drawn_population("clustered errors", cluster=3.0),
        drawn_population("interpreter right in 90 %", accuracy=0.9),
    ]
    if plan is not None and truth is not None:
        populations += [
            rendered_population("rendered map", plan, truth, 1.0),
            rendered_population("rendered map, interpreter right in 90 %", plan, truth, 0.9),
        ]
    found = [row for population in populations for row in coverage(population, cells, samples)]
    rows = [
        (r.population, r.figure, f"{100 * r.truth:.1f} %", f"{100 * r.covered:.1f} %", f"{100 * r.half_width:.1f} %")
        for r in found
    ]
    columns = ("map", "figure", ">true value", ">intervals that contain it", ">half-width")
    print_table(Console(), f"{samples} samples of {cells} cells, 95 % intervals", columns, rows)
    if json_path is not None:
        write_figures(json_path, {"samples": samples, "cells": cells, "coverage": [asdict(row) for row in found]})
