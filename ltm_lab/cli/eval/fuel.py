"""`ltm-lab eval fuel`: scores the evidence map and the paper's majority vote, in trials of known truth or on a bag."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def fuel(
    bag: Annotated[
        Path | None,
        typer.Argument(help="Recorded run with votes, to score instead of trials; such as out/demo/recording."),
    ] = None,
    site: Annotated[Path | None, typer.Option("--site", help="Of BAG; default: beside it, or a shipped one.")] = None,
    truth: Annotated[Path | None, typer.Option("--truth", help="Of BAG: folder of truth rasters.")] = None,
    date: Annotated[str | None, typer.Option("--date", help="Of BAG: of a truth folder with several dates.")] = None,
    repeat_hours: Annotated[
        float, typer.Option(help="Of BAG: count its frames again and again for so long, as if nothing new came.", min=0)
    ] = 1.0,
    dem: Annotated[Path | None, typer.Option(help="Terrain of the trials; a synthetic one where not given.")] = None,
    model: Annotated[
        str,
        typer.Option(help="Network whose errors are drawn: its name, or a YAML file as in config/fuel/label_errors."),
    ] = "default",
    trials: Annotated[str, typer.Option(help="Only trials whose name holds one of these, with semicolons.")] = "",
    seeds: Annotated[int, typer.Option(help="Countries for each trial.", min=1)] = 3,
    first_seed: Annotated[int, typer.Option(help="Seed of the first of them.", min=1)] = 1,
    levels: Annotated[
        str, typer.Option(help="Draw so many times the network's share of wrong labels, with commas: the trade-off.")
    ] = "1",
    hours: Annotated[
        str, typer.Option(help="Hours at which each view is taken, with commas; default: as each trial has it.")
    ] = "",
    json_path: JsonFile = None,
) -> None:
    """Score flips, false flips and right cells of the evidence map and the majority vote, trial by trial or of BAG;
    of reported changes user's and producer's accuracy, as many as here and at 1 % changed."""
    from ltm_lab.cli.eval.fuel_tables import score_recording, score_trials

    if bag is not None:
        score_recording(bag, site, truth, date, repeat_hours, json_path)
    else:
        score_trials(dem, model, trials, range(first_seed, first_seed + seeds), levels, hours, json_path)
