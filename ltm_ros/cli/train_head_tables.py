"""Tables of `ltm train head`: scores side by side, and which class is confused with which."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

if TYPE_CHECKING:
    from ltm_core.label_heads.head_trial import HeadScore
    from ltm_core.scoring.labels import SegmentationScore


def score_table(names: tuple[str, ...], scores: Mapping[str, HeadScore], title: str) -> Table:
    """Return a table with a column for each network and a row for each figure; classes without truth have no row."""
    table = Table(title=title)
    table.add_column("")
    for name in scores:
        table.add_column(name, justify="right")
    each = list(scores.values())
    first = each[0].labels
    for k, name in enumerate(names):
        if first.true[k] > 0:
            share = first.true[k] / first.pixels
            table.add_row(f"F1 {name} ({share:.1%})", *(_text(float(s.labels.f1[k])) for s in each))
    among = ", ".join(names[k] for k in each[0].macro if first.true[k] > 0)
    for label, values in (
        (f"macro F1 ({among})", [s.macro_f1 for s in each]),
        ("share of pixels right", [s.labels.accuracy for s in each]),
        ("share of pixels unlabelled", [s.labels.unlabelled for s in each]),
        ("calibration error (ECE)", [s.calibration.ece for s in each]),
        ("calibration error on land", [s.land_calibration.ece for s in each]),
        ("risk on land", [s.land_calibration.risk() for s in each]),
        ("risk on land at 80 % coverage", [s.land_calibration.risk(0.8) for s in each]),
    ):
        table.add_row(label, *(_text(value) for value in values))
    return table


def confusion_table(names: tuple[str, ...], score: SegmentationScore, title: str) -> Table:
    """Return the shares of each true class by label; the last column holds unlabelled pixels."""
    table = Table(title=f"{title}: rows are true, columns given")
    table.add_column("")
    for name in (*names, "unlabelled"):
        table.add_column(name, justify="right")
    for k, name in enumerate(names):
        if score.true[k] > 0:
            shares = score.confusion[k] / score.true[k]
            table.add_row(name, *("." if share == 0 else f"{share:.3f}" for share in shares))
    return table


def _text(value: float) -> str:
    return f"{value:.3f}" if np.isfinite(value) else "-"
