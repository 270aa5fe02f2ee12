"""Segmentation scores as a table for the terminal."""

from __future__ import annotations

from rich.table import Table

from ltm_lab.evaluation.metrics.segmentation import SegmentationScore


def score_table(names: tuple[str, ...], score: SegmentationScore, title: str) -> Table:
    """Scores by class as a table."""
    table = Table(title=title)
    for column in ("class", "share of truth", "IoU", "F1", "precision", "recall"):
        table.add_column(column, justify="left" if column == "class" else "right")
    for index, name in enumerate(names):
        share = score.true[index] / max(score.pixels, 1)
        values = (score.iou[index], score.f1[index], score.precision[index], score.recall[index])
        table.add_row(name, f"{share:.1%}", *(f"{value:.3f}" if value == value else "-" for value in values))
    table.add_section()
    table.add_row(
        "all", f"{score.pixels} px", f"{score.mean_iou:.3f}", f"right {score.accuracy:.1%}",
        f"unlabelled {score.unlabelled:.1%}", "",
    )  # fmt: skip
    return table
