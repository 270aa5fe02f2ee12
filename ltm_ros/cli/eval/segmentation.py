"""`ltm eval segmentation`: compares label networks on labelled frames."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_ros.cli.output import JsonFile

if TYPE_CHECKING:
    from ltm_core.evaluation.segmentation.network_score import LabelScore


def segmentation(
    folder: Annotated[
        Path, typer.Argument(help="Folder of frames NAME.png or .jpg with NAME_labels.png, or of several such folders.")
    ],
    model: Annotated[
        list[str] | None,
        typer.Option("--model", help="Model name or manifest; again for more. Default: the default one."),
    ] = None,
    json_path: JsonFile = None,
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 1,
    zoom: Annotated[float, typer.Option(min=1.0, help="Second look at distant slopes, so much larger.")] = 1.0,
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many frames of a folder, evenly chosen.")] = None,
) -> None:
    """Score networks on frames with true labels: F1 by class, sky, skyline, calibration, time; one table a folder.

    Labels of 255 are not counted. Skylines are compared at a width of 512 pixels.
    """
    import os
    import platform

    import numpy as np
    from rich.console import Console
    from rich.table import Table

    from ltm_core.errors import RecordingError
    from ltm_core.evaluation.segmentation.network_score import score_frames
    from ltm_core.training.labelled_frames import LABELS_SUFFIX, read_frames
    from ltm_core.vision.segmenter import DEFAULT_MODEL, Segmenter
    from ltm_ros.evaluation.figures_io import write_figures

    def holds_frames(path: Path) -> bool:
        return any(path.glob(f"*{LABELS_SUFFIX}"))

    sets = [folder] if holds_frames(folder) else sorted(p for p in folder.iterdir() if p.is_dir() and holds_frames(p))
    if not sets:
        raise RecordingError(
            f"{folder}: no frames; expected pictures NAME.png with NAME{LABELS_SUFFIX}, or folders of them"
        )
    console = Console()
    segmenters = [Segmenter.open(name, threads) for name in model or [DEFAULT_MODEL]]
    conditions = {
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "threads": threads,
        "zoom": zoom,
        "skyline_width": 512,
    }
    result: dict[str, object] = {"conditions": conditions}
    console.print(", ".join(f"{key} {value}" for key, value in conditions.items()))
    for path in sets:
        frames = read_frames(path, len(segmenters[0].labels), sampled=True)
        if limit is not None and limit < len(frames):
            frames = [frames[i] for i in np.linspace(0, len(frames) - 1, limit).round().astype(int)]
        scores = {s.manifest.name: score_frames(s, frames, zoom) for s in segmenters}
        names = segmenters[0].labels.names
        table = Table(
            title=f"{path}: {len(frames)} frames, {next(iter(scores.values())).labels.pixels} labelled pixels"
        )
        table.add_column("")
        for name in scores:
            table.add_column(name, justify="right")
        for label, row in _rows(names, list(scores.values())):
            table.add_row(label, *row)
        console.print(table)
        result[path.name] = {name: score.summary(names) for name, score in scores.items()}
    if json_path is not None:
        write_figures(json_path, result)


def _rows(names: tuple[str, ...], scores: list[LabelScore]) -> list[tuple[str, list[str]]]:
    def text(value: float, form: str) -> str:
        return format(value, form) if value == value else "-"

    rows = [
        (f"F1 {name} ({scores[0].labels.true[k] / max(scores[0].labels.pixels, 1):.1%})",
         [text(float(s.labels.f1[k]), ".3f") for s in scores])
        for k, name in enumerate(names)
        if scores[0].labels.true[k] > 0
    ]  # fmt: skip
    rows += [
        ("macro F1, land and sky", [text(s.macro_f1, ".3f") for s in scores]),
        ("sky IoU", [text(s.sky_iou, ".3f") for s in scores]),
        ("skyline, median px of 512", [text(s.skyline.median, ".2f") for s in scores]),
        ("skyline, 95th percentile px", [text(s.skyline.p95, ".1f") for s in scores]),
        ("skyline columns missed", [f"{s.skyline.missed}" for s in scores]),
        ("pixels right", [text(s.labels.accuracy, ".1%") for s in scores]),
        ("pixels left unlabelled", [text(s.labels.unlabelled, ".1%") for s in scores]),
        ("calibration error (ECE)", [text(s.calibration.ece, ".3f") for s in scores]),
        ("ms a frame, median", [text(s.milliseconds, ".0f") for s in scores]),
    ]
    return rows
