"""`ltm-lab eval lens`: unknown lenses, on a surveyed webcam and on rendered images that a lens bends."""

from pathlib import Path
from typing import Annotated

import typer

from ltm_lab.options import JsonFile


def lens(
    folders: Annotated[list[Path] | None, typer.Argument(help="Folders written by `ltm-lab simulate`.")] = None,
    finse: Annotated[Path | None, typer.Option(help="Folder of the surveyed webcam (shared/data/finse).")] = None,
    kind: Annotated[str, typer.Option(help="Kind of the webcam's lens: phone, ptz, action, slr, any.")] = "ptz",
    starts: Annotated[int, typer.Option(help="Number of starts 10, 3 and 1 degrees off.", min=0)] = 12,
    k1: Annotated[float, typer.Option(help="Distortion given to the rendered images.")] = -0.26,
    every: Annotated[int, typer.Option(help="Use each n-th frame of a folder.", min=1)] = 1,
    seed: Annotated[int, typer.Option(help="Seed of the disturbances.")] = 1,
    json_path: JsonFile = None,
) -> None:
    """Search poses with lenses that are not known, and score held-out points of fits with k1 and with a whole lens."""
    from dataclasses import asdict

    from rich.console import Console

    from ltm_core.base.errors import ConfigError
    from ltm_lab.cli.eval.score_table import print_table
    from ltm_lab.cli.eval.trial_runner import report
    from ltm_lab.evaluation.pose.lens_trial import run_finse, run_rendered, score_held_out

    if finse is None and not folders:
        raise ConfigError("nothing to score: give --finse, or folders of `ltm-lab simulate`")
    console = Console()
    held_out = score_held_out(finse, kind) if finse else []
    rows = [
        (s.fit, s.points, f"{s.inside:.0%}", s.used, f"{s.inside_used:.0%}", f"{s.rmse:.2f}", f"{s.median:.2f}",
         f"{s.median_fitted:.2f}")
        for s in held_out
    ]  # fmt: skip
    if rows:
        columns = (
            "fit",
            "points",
            "inside 95 %",
            "not rejected",
            "inside 95 % of these",
            "RMSE px",
            "median px",
            "median px, fitted",
        )
        print_table(console, "held-out points of the webcam", columns, rows)
    trials = run_finse(finse, kind, starts) if finse else []
    for folder in folders or []:
        trials += run_rendered(folder, k1, every, seed)
    title = f"{sum(t.verdict == 'accepted' for t in trials)} of {len(trials)} poses accepted; errors in degrees"
    print_table(
        console,
        title,
        ("case", "verdict", "azimuth", "pitch", "roll", "sigmas", "k1", "names the lens"),
        [
            (t.case, t.verdict, *(f"{e:+.3f}" for e in t.error), " ".join(f"{s:.2f}" for s in t.sigma), f"{t.k1:+.3f}",
             "yes" if t.names_lens else "")
            for t in trials
        ],
    )  # fmt: skip
    places = [str(place) for place in (finse, *(folders or [])) if place]
    report(console, f"{', '.join(places)}; k1 {k1:+.2f}", trials, json_path, held_out=[asdict(s) for s in held_out])
