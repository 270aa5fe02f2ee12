"""`ltm-lab eval assessment`: how often the 95 % intervals of `ltm assess report` contain the truth."""

from pathlib import Path
from typing import Annotated

from typer import Option

from ltm_lab.options import JsonFile


def assessment(
    plan: Annotated[Path | None, Option(help="Folder of `ltm assess plan` for a rendered map; needs --truth.")] = None,
    truth: Annotated[Path | None, Option(help="GeoTIFF of the rendered map's true life forms.")] = None,
    cells: Annotated[int, Option(min=20, help="Sampled cells.")] = 300,
    samples: Annotated[int, Option(min=10, help="Number of samples.")] = 5000,
    seed: Annotated[int, Option(min=0, help="Seed of maps, interpreters and samples.")] = 1,
    json_path: JsonFile = None,
) -> None:
    """Draw samples of maps with known truth, with simulated interpreters, and count intervals that contain the truth.

    An interpreter's errors bias all figures: the interval is of what he would answer in all cells.
    """
    from dataclasses import asdict
    from itertools import pairwise

    from ltm_core.assessment.estimation import FEWEST_EVENTS
    from ltm_lab.evaluation.assessment_trial import coverage, drawn_population, rendered_population
    from ltm_ros.cli.output import print_table
    from ltm_ros.pages import write_figures

    populations = [
        drawn_population("standard", seed),
        drawn_population("1 % change", seed, changed=0.01),
        drawn_population("1 % change, no other errors", seed, changed=0.01, errors=0.0),
        drawn_population("clustered errors", seed, cluster=3.0),
        drawn_population("interpreter right in 90 %", seed, accuracy=0.9),
    ]
    if plan is not None and truth is not None:
        populations += [
            rendered_population("rendered map", plan, truth, seed, 1.0),
            rendered_population("rendered map, interpreter right in 90 %", plan, truth, seed, 0.9),
        ]
    found = [row for population in populations for row in coverage(population, cells, samples, seed)]
    rows = [
        (r.population, r.figure, *(f"{100 * v:.1f} %" for v in (r.truth, r.covered, r.half_width)), f"{r.events:.1f}")
        for r in found
    ]
    columns = ("map", "figure", ">true value", ">intervals that contain it", ">half-width", ">events")
    print_table(f"{samples} samples of {cells} cells, 95 % intervals", columns, rows)
    bounds = (0.0, 3.0, FEWEST_EVENTS, float("inf"))
    bands = []
    for low, high in pairwise(bounds):
        covered = [r.covered for r in found if low <= r.events < high]
        ends = (min(covered), sum(covered) / len(covered), max(covered)) if covered else ()
        within = sum(0.93 <= share <= 0.97 for share in covered)
        events = f"{low:g} to {high:g}" if high < float("inf") else f"{low:g} or more"
        bands.append((events, f"{within} of {len(covered)}", *(f"{100 * v:.1f} %" for v in ends)))
    by_events = (">events", ">in 93 to 97 %", ">lowest", ">mean", ">highest")
    print_table("Figures by events", by_events, bands)
    if json_path is not None:
        write_figures(
            json_path, {"samples": samples, "cells": cells, "seed": seed, "coverage": [asdict(row) for row in found]}
        )
