"""Draws the loss and validation curves of a training run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ltm_core.training.loop import Run

_SMOOTH = 25  # steps over which the thick line of the loss averages


def write_curve(path: Path, name: str, run: Run) -> None:
    """Write a PNG: loss of each step, thin, and its running mean; mean F1 at each validation."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 4.0), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    steps = np.arange(1, len(run.losses) + 1)
    axes.plot(steps, run.losses, color="#b9c4cf", linewidth=0.6)
    width = min(_SMOOTH, len(run.losses))
    if width:
        smooth = np.convolve(run.losses, np.ones(width) / width, mode="valid")
        axes.plot(steps[width - 1 :], smooth, color="#1f4e79", linewidth=1.6, label=f"loss, mean of {width} steps")
    axes.set_xlabel("step")
    axes.set_ylabel("loss", color="#1f4e79")
    axes.set_title(f"Training of {name}", loc="left")
    axes.spines[["top"]].set_visible(False)
    if run.validations:
        right = axes.twinx()
        right.plot(*zip(*run.validations, strict=True), color="#c4722d", marker="o", markersize=3, linewidth=1.4)
        right.set_ylabel("validation: mean F1", color="#c4722d")
        right.set_ylim(0.0, 1.0)
        right.spines[["top"]].set_visible(False)
    figure.savefig(path)
