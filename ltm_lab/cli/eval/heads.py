"""`ltm-lab eval heads`: which head `label_head: auto` chooses for photos, each by itself."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_core.vision.manifest import DEFAULT_MODEL
from ltm_ros.cli.output import JsonFile, writable_folder


def heads(
    folders: Annotated[list[Path], typer.Argument(help="Folders of photos; labels are not needed.")],
    heads_folder: Annotated[
        Path | None, typer.Option("--heads", help="A folder of heads that is looked in first, as a site's.")
    ] = None,
    model: Annotated[str, typer.Option(help="The network, or one that takes its heads.")] = DEFAULT_MODEL,
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many of a folder, evenly chosen.")] = None,
    threads: Annotated[int, typer.Option(help="CPU threads of the network.")] = 1,
    overlays: Annotated[
        Path | None,
        typer.Option(help="Draw each photo beside its labels, PNG, into this folder.", callback=writable_folder),
    ] = None,
    json_path: JsonFile = None,
) -> None:
    """Tell which head `auto` chooses for each photo by itself, and all log odds against the network's own."""
    from collections import Counter

    from rich.console import Console
    from rich.table import Table

    from ltm_core.base.evenly import evenly
    from ltm_core.storage.photo_io import read_rgb
    from ltm_core.vision.head_choice_io import heads_to_choose, open_choice
    from ltm_core.vision.manifest import AUTO_HEAD, SHIPPED_LABEL_HEAD, NetworkManifest
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.evaluation.figures_io import write_figures
    from ltm_lab.evaluation.segmentation.overlays_io import write_answer
    from ltm_ros.recordings.camera_pictures import pictures_in

    console, manifest = Console(), NetworkManifest.find(model).serving(AUTO_HEAD)
    choice = open_choice(manifest, heads_folder)
    for path, reason in heads_to_choose(manifest, heads_folder)[1].items():
        console.print(f"passed over: {path}: {reason}", highlight=False)
    segmenter = Segmenter(manifest, threads, choice=choice)
    names = [SHIPPED_LABEL_HEAD, *(head.name for head in choice.heads)]
    figures = {}
    for folder in folders:
        paths = pictures_in(folder)
        rows = []
        for path in paths if limit is None else evenly(paths, limit):
            odds = segmenter.head_odds(photo := read_rgb(path))
            head = choice.alone(odds)
            name = SHIPPED_LABEL_HEAD if head is None else head.name
            rows.append((path.name, name, odds))
            if overlays is not None:
                write_answer(overlays, name, segmenter.labels, path, photo, segmenter.segment(photo))
        counted = Counter(name for _, name, _ in rows)
        table = Table("photo", "head", *(f"log odds, {name}" for name in names[1:]), title=f"{folder}")
        for stem, name, odds in rows:
            table.add_row(stem, name, *(["-"] * len(choice.heads) if odds is None else [f"{v:+.2f}" for v in odds[1:]]))
        console.print(table)
        told = ", ".join(f"{name} {counted[name]}" for name in names)
        console.print(f"{folder}: {len(rows)} photos: {told}", highlight=False)
        figures[folder.resolve().name] = {
            "photos": len(rows),
            "chosen": dict(counted),
            "log_odds": {stem: None if odds is None else odds[1:].tolist() for stem, _, odds in rows},
        }
    if json_path is not None:
        write_figures(json_path, figures)
