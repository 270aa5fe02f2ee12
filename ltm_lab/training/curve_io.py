"""Draws the loss and validation curves of a training run."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ltm_lab.training.loop import Run

_SMOOTH = 25
"""Steps over which the thick line of the loss averages."""
_LOSS, _SCORE = "#1f4e79", "#c4722d"


def write_curve(path: Path, name: str, run: "Run") -> None:
    """Write the curves of a run as a PNG."""
    training_figure(name, run.losses, run.validations).savefig(path)


def training_figure(name: str, losses: Sequence[float], validations: Sequence[tuple[int, float]]) -> "Figure":
    """Loss of each step, thin, and its running mean; mean F1 at each validation (step, score)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 4.4), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(np.arange(1, len(losses) + 1), losses, color="#b9c4cf", linewidth=0.6, label="loss of a step")
    width = min(_SMOOTH, len(losses))
    if width:
        smooth = np.convolve(losses, np.ones(width) / width, mode="valid")
        # Each mean in the middle of its steps: at their end the line would run behind.
        middles = np.arange(len(smooth)) + (width + 1) / 2
        axes.plot(middles, smooth, color=_LOSS, linewidth=1.6, label=f"mean over {width} steps")
    axes.set_xlabel("step")
    axes.set_ylabel("loss", color=_LOSS)
    axes.set_title(f"Training of {name}", loc="left")
    axes.spines["top"].set_visible(False)
    if validations:
        right = axes.twinx()
        steps, scores = zip(*validations, strict=True)
        right.plot(steps, scores, color=_SCORE, marker="o", markersize=3, linewidth=1.4, label="validation: mean F1")
        right.set_ylabel("validation: mean F1", color=_SCORE)
        right.set_ylim(0.0, 1.0)
        right.spines["top"].set_visible(False)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize="small")
    return figure
