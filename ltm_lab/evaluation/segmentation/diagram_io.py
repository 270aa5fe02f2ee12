"""Draws how far a network's confidence can be believed on land: reliability, and risk by coverage."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ltm_lab.evaluation.segmentation.network_score import LabelScore

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_diagram(path: Path, scores: Mapping[str, LabelScore]) -> None:
    """Write `confidence_figure` as a PNG."""
    confidence_figure(scores).savefig(path)


def confidence_figure(scores: Mapping[str, LabelScore]) -> Figure:
    """Two panels, a line for each score by name: share of right labels by confidence, and share of wrong labels among
    the surest part of the pixels. Bins of fewer than a thousandth of the pixels are left out."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.8), dpi=110, layout="constrained")
    reliability, risk = figure.subplots(1, 2)
    for name, score in scores.items():
        bins = score.land_calibration
        kept = bins.pixels > 1e-3 * bins.pixels.sum()
        reliability.plot(
            bins.confidence[kept] / bins.pixels[kept], bins.right[kept] / bins.pixels[kept], "o-", markersize=3,
            label=f"{name}: {bins.ece:.2f}",
        )  # fmt: skip
        coverage = np.linspace(0.05, 1.0, 39)
        risk.plot(coverage, [score.land_risk.risk(c) for c in coverage])
    reliability.plot([0, 1], [0, 1], color="0.7", linewidth=1, zorder=0, label="as sure as right: 0")
    reliability.set(
        xlabel="confidence (mean of a bin)", ylabel="share of right labels (of land pixels)",
        xlim=(0, 1), ylim=(0, 1), title="reliability",
    )  # fmt: skip
    risk.set(
        xlabel="coverage (share of land pixels, the surest first)", ylabel="share of wrong labels (of these)",
        xlim=(0, 1), ylim=(0, None), title="risk by coverage",
    )  # fmt: skip
    for axes in (reliability, risk):
        axes.grid(color="0.92")
        axes.set_axisbelow(True)
    figure.legend(*reliability.get_legend_handles_labels(), fontsize="small", loc="outside lower center", ncols=2,
                  title="expected calibration error on land")  # fmt: skip
    return figure
