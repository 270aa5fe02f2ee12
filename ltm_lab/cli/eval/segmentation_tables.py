"""Prints scores of label networks: side by side, by class, and confusion."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console

from ltm_lab.cli.eval.score_table import print_table

if TYPE_CHECKING:
    from ltm_core.scoring.labels import SegmentationScore
    from ltm_lab.evaluation.segmentation.network_score import LabelScore


def print_scores(console: Console, names: Sequence[str], scores: "Mapping[str, LabelScore]", title: str) -> None:
    """Print a column for each network and a row for each figure; classes that do not occur in truth are left out."""
    print_table(console, title, ("", *scores), _rows(names, list(scores.values())))


def print_class_scores(console: Console, names: Sequence[str], score: "SegmentationScore", title: str) -> None:
    """Print the scores of one network by class."""
    rows: list[tuple[str, ...]] = []
    for k, name in enumerate(names):
        values = (score.iou[k], score.f1[k], score.precision[k], score.recall[k])
        rows.append((name, f"{score.true[k] / max(score.pixels, 1):.1%}", *(_text(float(v), ".3f") for v in values)))
    rows += [
        (),
        (
            "all", f"{score.pixels} px", f"{score.mean_iou:.3f}", f"right {score.accuracy:.1%}",
            f"unlabelled {score.unlabelled:.1%}", "",
        ),
    ]  # fmt: skip
    print_table(console, title, ("class", "share of truth", "IoU", "F1", "precision", "recall"), rows)


def print_confusion(console: Console, names: Sequence[str], score: "SegmentationScore", title: str) -> None:
    """Print the shares of each true class by label; the last column is what was left unlabelled."""
    rows = []
    for k, name in enumerate(names):
        if score.true[k] > 0:
            shares = score.confusion[k] / score.true[k]
            rows.append((name, *("." if share == 0 else f"{share:.3f}" for share in shares)))
    print_table(console, f"{title}: rows are true, columns given", ("", *names, "unlabelled"), rows)


def _rows(names: Sequence[str], scores: "list[LabelScore]") -> list[tuple[str, ...]]:
    first = scores[0].labels
    rows: list[tuple[str, ...]] = [
        (
            f"F1 {name} ({first.true[k] / max(first.pixels, 1):.1%})",
            *(_text(float(s.labels.f1[k]), ".3f") for s in scores),
        )
        for k, name in enumerate(names)
        if first.true[k] > 0
    ]
    among = ", ".join(names[k] for k in scores[0].macro if first.true[k] > 0)
    rows += [
        (f"macro F1 ({among})", *(_text(s.macro_f1, ".3f") for s in scores)),
        ("shrub called tree", *(_text(s.shrub_as_tree, ".3f") for s in scores)),
        ("sky IoU", *(_text(s.sky_iou, ".3f") for s in scores)),
        ("skyline, median px of 512", *(_text(s.skyline.median, ".2f") for s in scores)),
        ("skyline, 95th percentile px", *(_text(s.skyline.p95, ".1f") for s in scores)),
        ("skyline columns missed", *(f"{s.skyline.missed}" for s in scores)),
        ("pixels right", *(_text(s.labels.accuracy, ".1%") for s in scores)),
        ("pixels left unlabelled", *(_text(s.labels.unlabelled, ".1%") for s in scores)),
        ("calibration error (ECE)", *(_text(s.calibration.ece, ".3f") for s in scores)),
        ("the same, true land alone", *(_text(s.land_calibration.ece, ".3f") for s in scores)),
        ("risk on land", *(_text(s.land_calibration.risk(), ".3f") for s in scores)),
        ("risk on land at 80 % coverage", *(_text(s.land_calibration.risk(0.8), ".3f") for s in scores)),
        ("ms a frame, median", *(_text(s.milliseconds, ".0f") for s in scores)),
    ]
    return rows


def _text(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "-"
