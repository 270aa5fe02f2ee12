"""Runs the trials of `ltm eval fuel` and prints their tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ltm_core.bench.measure import conditions
from ltm_core.dem import Dem
from ltm_core.errors import ConfigError
from ltm_core.evaluation.fuel.map_score import Share
from ltm_core.evaluation.fuel.trial import TRIALS, TUNING_SEEDS, Trial
from ltm_core.evaluation.fuel.trial_score import TrialScore, run_trial
from ltm_core.fuel.label_errors import LabelErrors
from ltm_core.fuel.life_form import LifeForm
from ltm_core.fuel.rules import FusionRules
from ltm_core.geodesy import SiteFrame
from ltm_core.vision.labels import LabelSet
from ltm_ros.evaluation.figures_io import write_figures
from ltm_ros.evaluation.fuel_score import FuelBagScore, score_fuel_bag
from ltm_ros.recordings.recorded_run import Recorded


def score_trials(
    dem: Path | None, model: str, names: str, seeds: Sequence[int], levels: str, path: Path | None
) -> None:
    """Raises ConfigError for names of no trial and levels that are no numbers."""
    console = Console()
    chosen = [t for t in TRIALS if any(part.strip() in t.name for part in names.split(";"))]
    if not chosen:
        raise ConfigError(f"no trial is called {names!r}; there are {'; '.join(t.name for t in TRIALS)}")
    errors = LabelErrors.load(Path(model)) if model.endswith((".yaml", ".yml")) else LabelErrors.of_model(model)
    ground, rules, labels = _ground(dem), FusionRules(), LabelSet.load()
    state = conditions(("numpy", "numba", "scipy"))
    console.print(
        f"{state.cpu}, {state.cores} cores, Python {state.python}; terrain {dem or 'synthetic'}; seeds "
        f"{', '.join(map(str, seeds))} (constants were chosen on {', '.join(map(str, TUNING_SEEDS))})",
        highlight=False,
    )
    console.print(f"labels of {model} ({errors.source}); right on {_right_on(errors)}", highlight=False)
    scores: list[tuple[float, TrialScore]] = []
    with console.status("") as status:
        for level in _levels(levels):
            for trial in chosen:
                for seed in seeds:
                    status.update(f"{trial.name}, {level:g} times the errors, seed {seed}")
                    scores.append((level, run_trial(trial, seed, errors.scaled(level), labels, rules, ground)))
    table = Table(
        title="fuel map: shares of the cells that are seen; mean of the seeds (worst)",
        caption="flipped: of the changed patch; well seen: those with evidence enough to change; code kept: of cells "
        "not changed and not seen; right: cells of the true life form; ms: processor time to count a frame",
    )
    for name in ("errors", "trial", "frames", "flipped", "well seen", "false flips", "code kept"):
        table.add_column(name, justify="left" if name == "trial" else "right")
    for name in ("right: ours", "vote", "prior", "ms"):
        table.add_column(name, justify="right")
    rows = []
    for level in _levels(levels):
        for trial in chosen:
            own = [score for at, score in scores if at == level and score.trial == trial.name]
            table.add_row(f"x {level:g}", *_cells(trial, own))
            rows.append({"level": level, "trial": trial.name, "seeds": [score.as_dict() for score in own]})
    console.print(table)
    _write(path, {"conditions": state.as_dict(), "terrain": str(dem or "synthetic"), "model": model, "trials": rows})


def _cells(trial: Trial, own: Sequence[TrialScore]) -> list[str]:
    def mean(name: str) -> float:
        return float(np.mean([getattr(score, name) for score in own]))

    def worst(name: str, digits: int, least: bool = True) -> str:
        values = [getattr(score, name) for score in own]
        return f"{mean(name):.{digits}%} ({min(values) if least else max(values):.{digits}%})"

    changes = ["", "", "", ""]
    if trial.has_prior:
        changes = [worst("flipped", 1), f"{mean('flipped_well_seen'):.1%}", worst("false_flips", 2, False)]
        changes.append(f"{min(score.code_kept for score in own):.0%}")
    right = [worst("ours", 1), worst("vote", 1), f"{mean('prior'):.1%}" if trial.has_prior else ""]
    return [trial.name, f"{mean('frames'):.0f}", *changes, *right, f"{mean('add_ms'):.1f}"]


def score_recording(
    bag: Path, site: Path | None, truth: Path | None, date: str | None, repeat_hours: float, path: Path | None
) -> None:
    """Raises RecordingError for a bag without votes or truth."""
    console = Console()
    recorded = Recorded.find(bag, site, truth, date)
    with console.status("counting"):
        score = score_fuel_bag(recorded, repeat_hours)
    console.print(
        f"{score.frames} frames of {bag}, network {recorded.site.model}, site {recorded.site_path}", highlight=False
    )
    table = Table(
        title="fuel map: cells that frames voted in",
        caption="found: of cells whose true life form is not the prior's, those that the map changed to it; false "
        "flips: of cells whose life form is the prior's, those that it changed",
    )
    for name in ("map", "life form", "right", "found", "false flips"):
        table.add_column(name, justify="left" if name in ("map", "life form") else "right")
    for found in score.maps:
        table.add_row(found.name, "all", _share(found.right), _share(found.found), _share(found.false_flips))
        for form, (right, false) in found.by_form.items():
            table.add_row("", form, _share(right), "", _share(false))
        table.add_section()
    console.print(table)
    if repeat_hours:
        console.print(f"cells that only the repeated frames changed: {score.unjustified}", highlight=False)
    console.print(f"network: {score.errors.source}; right on {_right_on(score.errors)}", highlight=False)
    _print_errors(console, score)
    _write(path, _figures(score))


def _print_errors(console: Console, score: FuelBagScore) -> None:
    if score.correlation is None or score.cells is None:
        console.print(f"[yellow]lacking[/] correlation of label errors: {score.lacking}", highlight=False)
        return
    for of, figures in (("known", score.errors.correlation), ("here", score.correlation)):
        text = ", ".join(f"{name}: {value:.2f}" for name, value in figures.model_dump().items())
        console.print(f"correlation of label errors, {of}: {{{text}}}", highlight=False)
    for form in LifeForm:
        row = score.cells[form - 1]
        if row.sum():
            shares = ", ".join(f"{LifeForm(k + 1).name.lower()} {n / row.sum():.0%}" for k, n in enumerate(row) if n)
            console.print(f"cells of {form.name.lower()} are mostly labelled {shares}", highlight=False)


def _figures(score: FuelBagScore) -> dict[str, Any]:
    maps = [
        {
            "map": found.name,
            "right": found.right.value,
            "found": found.found.value,
            "false_flips": found.false_flips.value,
            "cells": found.right.of,
            "by_form": {form: [right.value, false.value] for form, (right, false) in found.by_form.items()},
        }
        for found in score.maps
    ]
    measured = None if score.correlation is None else score.correlation.model_dump()
    return {"frames": score.frames, "maps": maps, "unjustified": score.unjustified, "correlation": measured}


def _share(share: Share) -> str:
    return f"{share.value:.2%} ({share.count}/{share.of})" if share.of else ""


def _right_on(errors: LabelErrors) -> str:
    right = np.diagonal(errors.shares)
    return ", ".join(f"{f.name.lower()} {right[f - 1]:.0%}" for f in LifeForm if np.isfinite(right[f - 1]))


def _levels(text: str) -> list[float]:
    try:
        levels = [float(part) for part in text.split(",")]
    except ValueError as error:
        raise ConfigError(f"--levels {text!r}: give numbers, such as 0.25,0.5,1") from error
    if min(levels) < 0:
        raise ConfigError(f"--levels {text!r}: none may be below 0")
    return levels


def _ground(dem: Path | None) -> Dem | None:
    if dem is None:
        return None
    opened = Dem.open(dem)
    x_min, y_min, x_max, y_max = opened.geometry.bounds
    return opened.in_frame(SiteFrame(str(opened.geometry.crs), (x_min + x_max) / 2, (y_min + y_max) / 2))


def _write(path: Path | None, figures: dict[str, Any]) -> None:
    if path is not None:
        write_figures(path, figures)
