"""`ltm-lab eval smoke`: what is told of smoke before the land, against smoke that a person has drawn."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_lab.resources import lab_config
from ltm_ros.cli.output import JsonFile


def smoke(
    photos: Annotated[Path, typer.Argument(help="Folder of the photos that the truth names.")],
    truth: Annotated[
        Path | None,
        typer.Option(help="JSON of pairs of photos and smoke; default: ltm_lab/config/evaluation/hpwren_smoke.json."),
    ] = None,
    model: Annotated[str, typer.Option(help="Segmentation network; default: the shipped one.")] = "",
    json_path: JsonFile = None,
) -> None:
    """Of pairs of photos of one view, count what of the later one's labels of land smoke takes away, rightly or not."""
    from dataclasses import asdict
    from functools import cache

    from rich.console import Console
    from rich.table import Table

    from ltm_core.base.types import UInt8Array
    from ltm_core.storage.photo_io import read_rgb
    from ltm_core.vision.manifest import DEFAULT_MODEL
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.evaluation.figures_io import write_figures
    from ltm_lab.evaluation.segmentation.smoke_score import read_pairs, score_pair

    pairs = read_pairs(lab_config("evaluation/hpwren_smoke.json") if truth is None else truth)
    segmenter = Segmenter.open(model or DEFAULT_MODEL)

    @cache
    def seen(name: str) -> tuple[UInt8Array, UInt8Array]:
        photo = read_rgb(photos / name)
        return photo, segmenter.segment(photo).labels

    table = Table("earlier", "later", "smoke called land", "of it told", "land beside", "told wrongly")
    figures = {}
    for pair in pairs:
        before, after = seen(pair.earlier), seen(pair.later)
        score = score_pair(pair, (before[0], after[0]), (before[1], after[1]))
        table.add_row(
            pair.earlier,
            pair.later,
            f"{score.in_smoke} of {score.hidden} px" if score.hidden else "-",
            f"{score.told / score.in_smoke:.0%}" if score.in_smoke else "-",
            f"{score.beside} px",
            f"{score.wrong / score.beside:.2%}" if score.beside else "-",
        )
        figures[f"{pair.earlier} {pair.later}"] = asdict(score)
    Console().print(table)
    if json_path is not None:
        write_figures(json_path, figures)
