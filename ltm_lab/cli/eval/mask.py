"""`ltm-lab eval mask`: what `ltm mask` proposes, against areas that a person has drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_lab.resources import lab_config
from ltm_ros.cli.output import JsonFile

KINDS = ("lens", "caption", "structure", None)


def mask(
    photos: Annotated[Path, typer.Argument(help="Folder of the photos that the truth names.")],
    truth: Annotated[
        Path | None,
        typer.Option(
            help="JSON of cameras, their pictures and areas; default: ltm_lab/config/evaluation/hpwren_masks.json."
        ),
    ] = None,
    model: Annotated[str, typer.Option(help="Segmentation network; default: the shipped one.")] = "",
    json_path: JsonFile = None,
) -> None:
    """Count proposals that are right and wrong, drawn areas that are missed, and the overlap, camera by camera."""
    from dataclasses import asdict

    from rich.console import Console
    from rich.table import Table

    from ltm_core.storage.photo_io import read_rgb
    from ltm_core.vision.manifest import DEFAULT_MODEL
    from ltm_core.vision.mask_proposals import propose_mask
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.evaluation.figures_io import write_figures
    from ltm_lab.evaluation.segmentation.mask_score import MaskScore, read_mask_truths, score_proposals

    truths = read_mask_truths(lab_config("evaluation/hpwren_masks.json") if truth is None else truth)
    segmenter = Segmenter.open(model or DEFAULT_MODEL)
    table = Table(
        "camera", "frames", "what", "right", "wrong", "drawn", "missed", "IoU", title="proposed masks, photos"
    )
    total = dict.fromkeys(KINDS, MaskScore())
    figures: dict[str, object] = {}

    def row(camera: str, frames: str, kind: str | None, score: MaskScore) -> None:
        iou = "-" if score.iou != score.iou else f"{score.iou:.2f}"
        counts = (str(n) for n in (score.right, score.wrong, score.areas, score.missed))
        table.add_row(camera, frames, kind or "all", *counts, iou)

    for one in truths:
        pictures = [read_rgb(photos / name) for name in one.pictures]
        proposals = propose_mask(pictures, segmenter)
        shape = pictures[0].shape[0], pictures[0].shape[1]
        scores = {kind: score_proposals(proposals, one, shape, kind) for kind in KINDS}
        for kind, score in scores.items():
            total[kind] += score
            if score.right or score.wrong or score.areas:
                row(one.camera if kind == KINDS[0] else "", str(len(pictures)), kind, score)
        figures[one.camera] = {kind or "all": asdict(score) | {"iou": score.iou} for kind, score in scores.items()}
        table.add_section()
    for kind, score in total.items():
        row("together" if kind == KINDS[0] else "", "", kind, score)
    Console().print(table)
    if json_path is not None:
        figures["together"] = {kind or "all": asdict(score) | {"iou": score.iou} for kind, score in total.items()}
        write_figures(json_path, figures)
