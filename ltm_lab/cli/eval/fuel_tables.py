"""Runs the trials of `ltm-lab eval fuel` and prints their tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from ltm_core.base.errors import ConfigError
from ltm_core.fuel.label_errors import LabelErrors
from ltm_core.fuel.life_form import LifeForm
from ltm_core.fuel.rules import FusionRules
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.raster.dem import Dem
from ltm_core.scoring.fuel_change import MapScore, Share
from ltm_core.vision.labels import LabelSet
from ltm_lab.bench.measure import conditions
from ltm_lab.evaluation.fuel.false_changes import FalseRegion
from ltm_lab.evaluation.fuel.trial import TRIALS, TUNING_SEEDS, Trial
from ltm_lab.evaluation.fuel.trial_score import TrialScore, run_trial
from ltm_lab.evaluation.fuel_score import FuelBagScore, score_fuel_bag
from ltm_ros.pages.figures_io import write_figures
from ltm_ros.recordings.recorded_run import Recorded

RARE = 0.01
"""Share of cells that truly change in a year or two, at which reports of change are judged too."""


def score_trials(
    dem: Path | None, model: str, names: str, seeds: Sequence[int], levels: str, hours: str, path: Path | None
) -> None:
    """Raises ConfigError for names of no trial, and levels and hours that are no numbers."""
    console = Console()
    chosen = [t for t in TRIALS if any(part.strip() in t.name for part in names.split(";"))]
    if not chosen:
        raise ConfigError(f"no trial is called {names!r}; there are {'; '.join(t.name for t in TRIALS)}")
    if hours:
        looks = _numbers(hours, "--hours", "0,1,24,168")
        chosen = [replace(trial, hours=looks) for trial in chosen]
    errors = LabelErrors.load(Path(model)) if model.endswith((".yaml", ".yml")) else LabelErrors.of_model(model)
    ground, rules, labels = _ground(dem), FusionRules(), LabelSet.load()
    state = conditions(("numpy", "numba", "scipy"))
    console.print(
        f"{state.cpu}, {state.cores} cores, Python {state.python}; terrain {dem or 'synthetic'}; seeds "
        f"{', '.join(map(str, seeds))} (constants were chosen on {', '.join(map(str, TUNING_SEEDS))})",
        highlight=False,
    )
    console.print(f"labels of {model} ({errors.source}); right on {_right_on(errors)}", highlight=False)
    factors = _numbers(levels, "--levels", "0.25,0.5,1")
    scores: list[tuple[float, TrialScore]] = []
    with console.status("") as status:
        for level in factors:
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
    change = Table(
        title="changes of life form that the map reports: mean of the seeds (worst)",
        caption="truly changed: of the cells that are seen; producer's accuracy: of these, those reported as what they "
        f"are; user's accuracy: of the cells reported, those that are so, with as many changed as here, and {RARE:.0%}",
    )
    for name in ("errors", "trial", "truly changed", "producer's", "user's", f"user's at {RARE:.0%}"):
        change.add_column(name, justify="left" if name == "trial" else "right")
    rows = []
    for level in factors:
        for trial in chosen:
            own = [score for at, score in scores if at == level and score.trial == trial.name]
            table.add_row(f"x {level:g}", *_cells(trial, own))
            rows.append({"level": level, "trial": trial.name, "seeds": [_told(score) for score in own]})
            if trial.has_prior:
                change.add_row(f"x {level:g}", trial.name, *_change_cells([s.changes for s in own if s.changes]))
    console.print(table)
    console.print(change)
    _write(path, {"conditions": state.as_dict(), "terrain": str(dem or "synthetic"), "model": model, "trials": rows})


def _told(score: TrialScore) -> dict[str, Any]:
    return score.as_dict() | ({} if score.changes is None else {"accuracy": _accuracy(score.changes)})


def _accuracy(changes: MapScore) -> dict[str, float]:
    return {
        "prevalence": changes.prevalence,
        "producers": changes.found.value,
        "users": changes.users_accuracy(),
        f"users_at_{RARE:g}": changes.users_accuracy(RARE),
    }


def _change_cells(own: Sequence[MapScore]) -> list[str]:
    columns = np.array([list(_accuracy(changes).values()) for changes in own]).T
    return [f"{columns[0].mean():.1%}", *(f"{column.mean():.1%} ({column.min():.1%})" for column in columns[1:])]


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
        "flips: of cells whose life form is the prior's, those that it changed; user's accuracy: of the cells that it "
        f"changed, those that are so, with as many truly changed as here, and with {RARE:.0%}",
    )
    for name in ("map", "life form", "right", "found", "false flips", "user's", f"user's at {RARE:.0%}"):
        table.add_column(name, justify="left" if name in ("map", "life form") else "right")
    for found in score.maps:
        values = found.users_accuracy(), found.users_accuracy(RARE)
        users = ("" if np.isnan(value) else f"{value:.1%}" for value in values)
        table.add_row(found.name, "all", _share(found.right), _share(found.found), _share(found.false_flips), *users)
        for form, (right, false) in found.by_form.items():
            table.add_row("", form, _share(right), "", _share(false))
        table.add_section()
    console.print(table)
    _print_false(console, score.false)
    if repeat_hours:
        console.print(f"cells that only the repeated frames changed: {score.unjustified}", highlight=False)
    console.print(f"network: {score.errors.source}; right on {_right_on(score.errors)}", highlight=False)
    _print_errors(console, score)
    _write(path, _figures(score))


def _print_false(console: Console, regions: Sequence[FalseRegion]) -> None:
    if not regions:
        return
    table = Table(
        title=f"what the {sum(region.cells for region in regions)} falsely changed cells are",
        caption="labels: of the pixels that voted there; footprint: metres of ground a pixel covers",
    )
    for name in (
        "cells",
        "row, col",
        "true",
        "map",
        "labels",
        "seen by",
        "footprint",
        "labels right",
        "beside a change",
    ):
        table.add_column(name, justify="right" if name in ("cells", "footprint") else "left")
    for region in regions:
        labels = [(share, LifeForm(k + 1).name.lower()) for k, share in enumerate(region.labels) if share >= 0.05]
        table.add_row(
            str(region.cells),
            f"{region.row}, {region.col}",
            region.true.name.lower(),
            region.mapped.name.lower(),
            ", ".join(f"{name} {share:.0%}" for share, name in sorted(labels, reverse=True)),
            ", ".join(region.cameras),
            f"{region.footprint:.1f}",
            "yes" if region.labelled_right else "no",
            "yes" if region.beside_change else "no",
        )
    console.print(table)


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
            "accuracy": _accuracy(found),
            "cells": found.right.of,
            "by_form": {form: [right.value, false.value] for form, (right, false) in found.by_form.items()},
        }
        for found in score.maps
    ]
    measured = None if score.correlation is None else score.correlation.model_dump()
    false = [
        {
            "cells": region.cells,
            "cell": [region.row, region.col],
            "true": region.true.name.lower(),
            "map": region.mapped.name.lower(),
            "labels": {form.name.lower(): region.labels[form - 1] for form in LifeForm},
            "cameras": region.cameras,
            "footprint": region.footprint,
            "beside_change": region.beside_change,
        }
        for region in score.false
    ]
    return {
        "false": false,
        "frames": score.frames,
        "maps": maps,
        "unjustified": score.unjustified,
        "correlation": measured,
    }


def _share(share: Share) -> str:
    return f"{share.value:.2%} ({share.count}/{share.of})" if share.of else ""


def _right_on(errors: LabelErrors) -> str:
    right = np.diagonal(errors.shares)
    return ", ".join(f"{f.name.lower()} {right[f - 1]:.0%}" for f in LifeForm if np.isfinite(right[f - 1]))


def _numbers(text: str, option: str, example: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigError(f"{option} {text!r}: give numbers, such as {example}") from error
    if not all(0 <= number < np.inf for number in numbers):
        raise ConfigError(f"{option} {text!r}: none may be below 0")
    return numbers


def _ground(dem: Path | None) -> Dem | None:
    if dem is None:
        return None
    opened = Dem.open(dem)
    x_min, y_min, x_max, y_max = opened.geometry.bounds
    return opened.in_frame(SiteFrame(str(opened.geometry.crs), (x_min + x_max) / 2, (y_min + y_max) / 2))


def _write(path: Path | None, figures: dict[str, Any]) -> None:
    if path is not None:
        write_figures(path, figures)
