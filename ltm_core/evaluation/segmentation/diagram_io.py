"""Draws how far a network's confidence can be believed on land: reliability, and risk by coverage."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ltm_core.evaluation.segmentation.network_score import LabelScore


def write_diagram(path: Path, scores: Mapping[str, LabelScore]) -> None:
    """Two panels, a line for each score by name: share of right labels by confidence, and share of wrong labels among
    the surest part of the pixels. Bins of fewer than a thousandth of the pixels are left out."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.8), dpi=110, layout="constrained")
    reliability, risk = figure.subplots(1, 2)
    reliability.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    for name, score in scores.items():
        bins = score.land_calibration
        kept = bins.pixels > 1e-3 * bins.pixels.sum()
        reliability.plot(
            bins.confidence[kept] / bins.pixels[kept], bins.right[kept] / bins.pixels[kept], "o-", markersize=3,
            label=f"{name}: {bins.ece:.2f}",
        )  # fmt: skip
        coverage = np.linspace(0.05, 1.0, 39)
        risk.plot(coverage, [score.land_risk.risk(c) for c in coverage])
    reliability.set(xlabel="confidence", ylabel="share of right labels", xlim=(0, 1), ylim=(0, 1), title="reliability")
    risk.set(xlabel="coverage", ylabel="share of wrong labels", xlim=(0, 1), ylim=(0, None), title="risk by coverage")
    figure.legend(*reliability.get_legend_handles_labels(), fontsize="small", loc="outside lower center", ncols=2,
                  title="expected calibration error on land")  # fmt: skip
    figure.savefig(path)
