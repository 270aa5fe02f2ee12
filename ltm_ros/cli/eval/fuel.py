"""`ltm eval fuel`: the evidence map beside the paper's majority vote, in trials whose truth is known."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def fuel(
    dem: Annotated[Path | None, typer.Option(help="Terrain of the trials; a synthetic one where not given.")] = None,
    model: Annotated[
        str, typer.Option(help="Network whose errors are drawn: a name in config/fuel/label_errors, or a YAML file.")
    ] = "default",
    trials: Annotated[str, typer.Option(help="Only trials whose name holds one of these, with commas.")] = "",
    seeds: Annotated[int, typer.Option(help="Countries for each trial.", min=1)] = 3,
    json: Annotated[Path | None, typer.Option(help="Write the figures here.")] = None,
) -> None:
    """Score flips, false flips and right cells of the evidence map and the majority vote, trial by trial."""
    import json as json_module

    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from ltm_core.bench.measure import conditions
    from ltm_core.dem import Dem
    from ltm_core.errors import ConfigError
    from ltm_core.fuel.label_errors import LabelErrors
    from ltm_core.fuel.life_form import LifeForm
    from ltm_core.fuel.rules import FusionRules
    from ltm_core.fuel.trial import TRIALS
    from ltm_core.fuel.trial_score import run_trial
    from ltm_core.geodesy import SiteFrame
    from ltm_core.vision.labels import LabelSet

    console = Console()
    chosen = [t for t in TRIALS if any(part in t.name for part in trials.split(","))]
    if not chosen:
        raise ConfigError(f"no trial is called {trials!r}; there are {', '.join(t.name for t in TRIALS)}")
    errors = LabelErrors.load(Path(model)) if model.endswith((".yaml", ".yml")) else LabelErrors.of_model(model)
    ground = None
    if dem is not None:
        opened = Dem.open(dem)
        x_min, y_min, x_max, y_max = opened.geometry.bounds
        frame = SiteFrame(str(opened.geometry.crs), (x_min + x_max) / 2, (y_min + y_max) / 2)
        ground = opened.in_frame(frame)
    rules, labels = FusionRules(), LabelSet.load()
    state = conditions(("numpy", "numba", "scipy"))
    console.print(
        f"{state.cpu}, {state.cores} cores, Python {state.python}; terrain {dem or 'synthetic'}, {seeds} seeds"
    )
    console.print(f"labels of {model} ({errors.source}); right on ", end="")
    right = np.diagonal(errors.shares)
    console.print(", ".join(f"{f.name.lower()} {right[f - 1]:.0%}" for f in LifeForm if np.isfinite(right[f - 1])))
    scores = []
    with console.status("") as status:
        for trial in chosen:
            for seed in range(1, seeds + 1):
                status.update(f"{trial.name}, seed {seed}")
                scores.append(run_trial(trial, seed, errors, labels, rules, ground))
    table = Table(
        title="fuel map: shares of the cells that are seen, mean of the seeds (least and most favourable)",
        caption="flipped: of the changed patch; well seen: with evidence enough to change; right: cells of the true "
        "life form; ms: processor time a frame takes to count",
    )
    for name in (
        "trial",
        "frames",
        "flipped",
        "well seen",
        "false flips",
        "code kept",
        "right: ours",
        "vote",
        "prior",
        "ms",
    ):
        table.add_column(name, justify="left" if name == "trial" else "right")
    rows: list[dict[str, Any]] = []
    for trial in chosen:
        own = [s.as_dict() for s in scores if s.trial == trial.name]
        mean = {key: float(np.mean([s[key] for s in own])) for key in own[0] if key not in ("trial", "seed")}
        rows.append({"trial": trial.name, "mean": mean, "seeds": own})
        flips = mean["flipped"], min(s["flipped"] for s in own), max(s["flipped"] for s in own)
        table.add_row(
            trial.name,
            f"{mean['frames']:.0f}",
            "" if not trial.has_prior else "{:.1%} ({:.0%}-{:.0%})".format(*flips),
            "" if not trial.has_prior else f"{mean['flipped_well_seen']:.1%}",
            "" if not trial.has_prior else f"{mean['false_flips']:.2%}",
            "" if not trial.has_prior else f"{mean['code_kept']:.0%}",
            f"{mean['ours']:.1%}",
            f"{mean['vote']:.1%}",
            f"{mean['prior']:.1%}" if trial.has_prior else "",
            f"{mean['add_ms']:.1f}",
        )
    console.print(table)
    if json is not None:
        report = {"conditions": state.as_dict(), "terrain": str(dem or "synthetic"), "model": model, "trials": rows}
        json.parent.mkdir(parents=True, exist_ok=True)
        json.write_text(json_module.dumps(report, indent=2))
