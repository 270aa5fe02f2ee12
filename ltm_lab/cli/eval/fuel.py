"""`ltm-lab eval fuel`: scores the evidence map and the paper's majority vote, in trials or on a recording."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_lab.cli.eval.trial_runner import Processes
from ltm_lab.options import JsonFile

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_core.fuel.label_errors import LabelErrors
    from ltm_core.scoring.fuel import MapScore, Share
    from ltm_lab.evaluation.fuel.trial_score import TrialScore


def fuel(
    bag: Annotated[
        Path | None, typer.Argument(help="Recorded run with votes, such as out/demo/recording. Default: trials.")
    ] = None,
    site: Annotated[Path | None, typer.Option("--site", help="Site file of BAG. Default: beside it.")] = None,
    truth: Annotated[Path | None, typer.Option("--truth", help="Folder of truth rasters of BAG.")] = None,
    date: Annotated[str | None, typer.Option("--date", help="Date of BAG in a truth folder of several.")] = None,
    repeat_hours: Annotated[
        float, typer.Option(help="Hours for which the frames of BAG are counted again and again.", min=0)
    ] = 1.0,
    dem: Annotated[Path | None, typer.Option(help="Terrain of the trials. Default: a synthetic one.")] = None,
    model: Annotated[
        str, typer.Option(help="Network whose label errors are drawn, or a YAML file of them; assumed: any.")
    ] = "assumed",
    trials: Annotated[str, typer.Option(help="Parts of the names of trials, separated by semicolons.")] = "",
    seeds: Annotated[int, typer.Option(help="Number of seeds of each trial.", min=1)] = 3,
    first_seed: Annotated[int, typer.Option(help="First seed.", min=1)] = 1,
    levels: Annotated[str, typer.Option(help="Factors of the share of wrong labels, separated by commas.")] = "1",
    hours: Annotated[
        str, typer.Option(help="Hours at which each view is taken, separated by commas. Default: the trial's.")
    ] = "",
    processes: Processes = 1,
    json_path: JsonFile = None,
) -> None:
    """Score changes found, false changes and right cells of the evidence map and the majority vote, in trials or on
    BAG; and the user's accuracy of reported changes, at the share of changes here and at 1 %."""
    if bag is not None:
        _score_recording(bag, site, truth, date, repeat_hours, json_path)
        return
    from dataclasses import replace

    from rich.console import Console

    from ltm_core.base.errors import ConfigError
    from ltm_core.fuel.label_errors import known_errors, stated_errors
    from ltm_lab.bench.measure import conditions
    from ltm_lab.cli.eval.trial_runner import report, run_trials
    from ltm_lab.evaluation.fuel.trial import TRIALS, TUNING_SEEDS
    from ltm_lab.evaluation.fuel.trial_score import FuelJob, run_fuel_job
    from ltm_lab.resources import lab_config

    chosen = [t for t in TRIALS if any(part.strip() in t.name for part in trials.split(";"))]
    if not chosen:
        raise ConfigError(f"--trials {trials!r} is in no trial's name; there are {'; '.join(t.name for t in TRIALS)}")
    if hours:
        times = _numbers(hours, "--hours", "0,1,24,168")
        chosen = [replace(trial, hours=times) for trial in chosen]
    file = lab_config("assumed_labels.yaml") if model == "assumed" else Path(model)
    errors = stated_errors(file) if file.suffix in (".yaml", ".yml") else known_errors(model)
    used = range(first_seed, first_seed + seeds)
    factors = _numbers(levels, "--levels", "0.25,0.5,1")
    jobs = [FuelJob(trial, seed, level, errors, dem) for level in factors for trial in chosen for seed in used]
    console = Console()
    scores = run_trials(run_fuel_job, jobs, processes, console)
    _print_trials(console, scores)
    machine = conditions(("numpy", "numba", "scipy"))
    state = (
        f"{machine.cpu}, {machine.cores} cores, Python {machine.python}; terrain {dem or 'synthetic'}; seeds "
        f"{', '.join(map(str, used))} (constants were chosen on {', '.join(map(str, TUNING_SEEDS))}); labels of "
        f"{model} ({errors.source}); right on {_right_on(errors)}"
    )
    report(console, state, scores, json_path)


def _print_trials(console: "Console", scores: "Sequence[TrialScore]") -> None:
    import numpy as np

    from ltm_lab.cli.eval.score_table import print_table
    from ltm_lab.evaluation.fuel.trial_score import RARE

    rows, changes = [], []
    for level, name in dict.fromkeys((score.level, score.trial) for score in scores):
        own = [score for score in scores if (score.level, score.trial) == (level, name)]

        def text(field: str, digits: int, worst: Callable[[list[float]], float] | None = min) -> str:
            values = [float(getattr(score, field)) for score in own]  # noqa: B023 # is used within this round
            mean = f"{np.mean(values):.{digits}%}"
            return mean if worst is None else f"{mean} ({worst(values):.{digits}%})"

        start = f"x {level:g}", name
        frames, kept = f"{np.mean([s.frames for s in own]):.0f}", f"{min(s.code_kept for s in own):.0%}"
        right, ms = (text("ours", 1), text("vote", 1)), f"{np.mean([s.add_ms for s in own]):.1f}"
        if np.isnan(own[0].changed):  # there is no prior
            rows.append((*start, frames, "", "", "", "", *right, "", ms))
            continue
        found = text("flipped", 1), text("flipped_well_seen", 1, None), text("false_flips", 2, max)
        rows.append((*start, frames, *found, kept, *right, text("prior", 1, None), ms))
        changes.append((*start, text("changed", 1, None), text("found", 1), text("users", 1), text("users_rare", 1)))
    print_table(
        console,
        "fuel map, shares of the seen cells: mean of the seeds (worst)",
        ("errors", "trial", "frames", "flipped", "well seen", "false flips", "code kept", "right: ours", "vote",
         "prior", "ms"),
        rows,
    )  # fmt: skip
    columns = ("errors", "trial", "truly changed", "producer's", "user's", f"user's at {RARE:.0%}")
    print_table(console, "reported changes of life form: mean of the seeds (worst)", columns, changes)


def _score_recording(
    bag: Path, site: Path | None, truth: Path | None, date: str | None, repeat_hours: float, path: Path | None
) -> None:
    from rich.console import Console

    from ltm_core.fuel.life_form import LifeForm
    from ltm_lab.cli.eval.score_table import print_table
    from ltm_lab.evaluation.dated_run import DatedRun
    from ltm_lab.evaluation.fuel_score import score_fuel_bag
    from ltm_ros.pages import write_figures

    console = Console()
    recorded = DatedRun.find(bag, site, truth, date)
    with console.status("counting"):
        score = score_fuel_bag(recorded, repeat_hours)
    rows: list[Sequence[str]] = []
    for found in score.maps:
        accuracy = ("" if value != value else f"{value:.1%}" for value in list(_accuracy(found).values())[2:])
        rows.append((found.name, "all", *map(_share, (found.right, found.found, found.false_flips)), *accuracy))
        rows += [("", form, _share(right), "", _share(false)) for form, (right, false) in found.by_form.items()]
    columns = ("map", "life form", "right", "found", "false flips", "user's", "user's at 1%")
    print_table(console, "fuel map: cells that frames voted in", columns, rows)
    lines = [f"{score.frames} frames of {bag}, network {recorded.site.model}, site {recorded.site_path}"]
    if repeat_hours:
        lines.append(f"cells that only the repeated frames changed: {score.unjustified}")
    lines.append(f"network: {score.errors.source}; right on {_right_on(score.errors)}")
    if score.correlation is None or score.cells is None:
        lines.append(f"no correlation of label errors: {score.lacking}")
    else:
        for kind, alike in (("known", score.errors.correlation), ("here", score.correlation)):
            text = ", ".join(f"{name}: {value:.2f}" for name, value in alike.model_dump().items())
            lines.append(f"correlation of label errors, {kind}: {{{text}}}")
        for form in LifeForm:
            row = score.cells[form - 1]
            shares = ", ".join(f"{LifeForm(k + 1).name.lower()} {n / row.sum():.0%}" for k, n in enumerate(row) if n)
            lines += [f"cells of {form.name.lower()} are mostly labelled {shares}"] if row.sum() else []
    console.print("\n".join(lines), highlight=False, markup=False)
    if path is not None:
        maps = [
            {
                "map": found.name,
                "right": found.right.value,
                "found": found.found.value,
                "false_flips": found.false_flips.value,
                "accuracy": _accuracy(found),
                "cells": found.right.of,
                "by_form": {form: [right.value, false.value] for form, (right, false) in found.by_form.items()},
            }
            for found in score.maps
        ]
        correlation = None if score.correlation is None else score.correlation.model_dump()
        figures = {"frames": score.frames, "maps": maps, "unjustified": score.unjustified, "correlation": correlation}
        write_figures(path, figures)


def _accuracy(changes: "MapScore") -> dict[str, float]:
    from ltm_lab.evaluation.fuel.trial_score import users_accuracy

    return {
        "prevalence": changes.prevalence,
        "producers": changes.found.value,
        "users": users_accuracy(changes),
        "users_at_0.01": users_accuracy(changes, 0.01),
    }


def _share(share: "Share") -> str:
    return f"{share.value:.2%} ({share.count}/{share.of})" if share.of else ""


def _right_on(errors: "LabelErrors") -> str:
    import numpy as np

    from ltm_core.fuel.life_form import LifeForm

    right = np.diagonal(errors.shares)
    return ", ".join(f"{f.name.lower()} {right[f - 1]:.0%}" for f in LifeForm if np.isfinite(right[f - 1]))


def _numbers(text: str, option: str, example: str) -> tuple[float, ...]:
    from ltm_core.base.errors import ConfigError

    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigError(f"{option} is {text!r}; give numbers, such as {example}") from error
    if not all(0 <= number < float("inf") for number in numbers):
        raise ConfigError(f"{option} is {text!r}; give numbers of at least 0")
    return numbers
