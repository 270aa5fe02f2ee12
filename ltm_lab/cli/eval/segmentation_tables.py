"""The table of `ltm-lab eval segmentation`: scores side by side."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

if TYPE_CHECKING:
    from ltm_lab.evaluation.segmentation.network_score import LabelScore


def score_table(names: tuple[str, ...], scores: Mapping[str, LabelScore], title: str) -> Table:
    """A column a network, a row a figure; classes that the truth does not hold are left out."""
    table = Table(title=title)
    table.add_column("")
    for name in scores:
        table.add_column(name, justify="right")
    for label, row in _rows(names, list(scores.values())):
        table.add_row(label, *row)
    return table


def _rows(names: tuple[str, ...], scores: list[LabelScore]) -> list[tuple[str, list[str]]]:
    first = scores[0].labels
    rows = [
        (
            f"F1 {name} ({first.true[k] / max(first.pixels, 1):.1%})",
            [_text(float(s.labels.f1[k]), ".3f") for s in scores],
        )
        for k, name in enumerate(names)
        if first.true[k] > 0
    ]
    among = ", ".join(names[k] for k in scores[0].macro if first.true[k] > 0)
    rows += [
        (f"macro F1 ({among})", [_text(s.macro_f1, ".3f") for s in scores]),
        ("shrub called tree", [_text(s.shrub_as_tree, ".3f") for s in scores]),
        ("sky IoU", [_text(s.sky_iou, ".3f") for s in scores]),
        ("skyline, median px of 512", [_text(s.skyline.median, ".2f") for s in scores]),
        ("skyline, 95th percentile px", [_text(s.skyline.p95, ".1f") for s in scores]),
        ("skyline columns missed", [f"{s.skyline.missed}" for s in scores]),
        ("pixels right", [_text(s.labels.accuracy, ".1%") for s in scores]),
        ("pixels left unlabelled", [_text(s.labels.unlabelled, ".1%") for s in scores]),
        ("calibration error (ECE)", [_text(s.calibration.ece, ".3f") for s in scores]),
        ("the same, true land alone", [_text(s.land_calibration.ece, ".3f") for s in scores]),
        ("risk on land", [_text(s.land_risk.risk(), ".3f") for s in scores]),
        ("risk on land at 80 % coverage", [_text(s.land_risk.risk(0.8), ".3f") for s in scores]),
        ("ms a frame, median", [_text(s.milliseconds, ".0f") for s in scores]),
    ]
    return rows


def _text(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "-"
