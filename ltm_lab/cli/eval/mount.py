"""`ltm-lab eval mount`: how well a few landmarks calibrate a pan-tilt head, on simulated heads."""

from __future__ import annotations

from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def mount(
    heads: Annotated[int, typer.Option(min=2, max=1000, help="Simulated heads for each number of landmarks.")] = 40,
    seed: Annotated[int, typer.Option(help="Of the heads and their landmarks.")] = 2026,
    json_path: JsonFile = None,
) -> None:
    """Worst error of a direction after a calibration by 4, 6, 8 landmarks, and without one. Simulated marks."""
    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from ltm_lab.evaluation.pose.landmark_trial import (
        ENCODER_DEG,
        LEAN_DEG,
        MARK_PX,
        TILT_ZERO_DEG,
        azimuth_only,
        landmark_trial,
        refused,
    )
    from ltm_ros.pages.figures_io import write_figures

    title = (
        f"{heads} simulated heads each (lean {LEAN_DEG[0]}, {LEAN_DEG[1]} deg, tilt zero {TILT_ZERO_DEG}, encoders "
        f"{ENCODER_DEG} deg, marks {MARK_PX} px): worst error of a direction, deg"
    )
    table = Table("calibrated by", "median", "p95", "largest", "error / stated sigma, p95", title=title)
    figures: dict[str, dict[str, float]] = {}

    def row(name: str, errors: list[float], ratios: list[float]) -> None:
        values = np.array(errors)
        told = {"median": float(np.median(values)), "p95": float(np.quantile(values, 0.95)), "max": float(values.max())}
        if ratios:
            told["z_p95"] = float(np.quantile(ratios, 0.95))
        figures[name] = told
        table.add_row(name, *(f"{told[key]:.3f}" for key in ("median", "p95", "max")), f"{told.get('z_p95', 0):.1f}")

    rng = np.random.default_rng(seed)
    row("azimuth only", [azimuth_only(rng) for _ in range(heads)], [])
    for count, spread in ((4, 360.0), (6, 360.0), (8, 360.0), (4, 40.0)):
        trials = [landmark_trial(count, rng, spread) for _ in range(heads)]
        name = f"{count} landmarks" + (f" within {spread:.0f} deg of pan" if spread < 360 else "")
        row(name, [error for error, _ in trials], [error / sigma for error, sigma in trials])
    console = Console()
    console.print(table)
    console.print(f"refused: {', '.join(str(n) for n in (1, 2, 3) if refused(n))} landmarks", highlight=False)
    if json_path is not None:
        write_figures(json_path, figures)
