"""`ltm train head`: train a label head for a site from a few labelled photos."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_ros.cli.output import JsonFile, writable_folder

if TYPE_CHECKING:
    from rich.table import Table

    from ltm_core.label_heads.head_trial import HeadScore
    from ltm_core.scoring.labels import SegmentationScore


def score_table(names: tuple[str, ...], scores: Mapping[str, HeadScore], title: str) -> Table:
    """Return a table with a column for each network and a row for each figure; classes without truth have no row."""
    from rich.table import Table

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
        ("correct share of pixels", [s.labels.accuracy for s in each]),
        ("unlabelled share of pixels", [s.labels.unlabelled for s in each]),
        ("calibration error (ECE)", [s.calibration.ece for s in each]),
        ("calibration error on land", [s.land_calibration.ece for s in each]),
        ("risk on land", [s.land_calibration.risk() for s in each]),
        ("risk on land at 80 % coverage", [s.land_calibration.risk(0.8) for s in each]),
    ):
        table.add_row(label, *(_text(value) for value in values))
    return table


def confusion_table(names: tuple[str, ...], score: SegmentationScore, title: str) -> Table:
    """Return the shares of each true class by label; the last column holds unlabelled pixels."""
    from rich.table import Table

    table = Table(title=f"{title}: rows are true classes, columns predicted ones")
    table.add_column("")
    for name in (*names, "unlabelled"):
        table.add_column(name, justify="right")
    for k, name in enumerate(names):
        if score.true[k] > 0:
            shares = score.confusion[k] / score.true[k]
            table.add_row(name, *("." if share == 0 else f"{share:.3f}" for share in shares))
    return table


def _text(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "-"


def head(
    photos: Annotated[
        Path,
        typer.Argument(
            help="Folder of photos with NAME_labels.png or polygons.json; sites.csv or NAME up to _ is the site."
        ),
    ],
    out: Annotated[str, typer.Option("--out", "-o", help="Name of the label head, or path of its file (.yaml).")],
    model: Annotated[
        str | None, typer.Option(help="Network, or a network with a label head. Default: the shipped one.")
    ] = None,
    also: Annotated[
        list[Path] | None,
        typer.Option(help="Labelled frames of other places, to measure the loss there. Repeatable."),
    ] = None,
    one_view: Annotated[
        bool, typer.Option("--one-view", help="All PHOTOS show one view; the head is used only for it.")
    ] = False,
    limit: Annotated[int, typer.Option(min=1, help="Maximum frames of each --also, evenly chosen.")] = 24,
    licence: Annotated[str, typer.Option(help="License of the photos, for the head's file.")] = "",
    threads: Annotated[int, typer.Option(help="CPU threads of the network.")] = 1,
    ignore: Annotated[str, typer.Option(help="True classes to ignore, separated by commas.", metavar="CLASSES")] = "",
    confidence: Annotated[
        float, typer.Option(min=0, max=0.99, help="Pixels of lower probability stay unlabelled.")
    ] = 0.4,
    tree_contrast: Annotated[
        float, typer.Option(min=0, help="Minimum contrast (8-bit steps) of tree among more shrub.")
    ] = 0.0,
    overlays: Annotated[
        Path | None,
        typer.Option(help="Draw the labels of held-out photos beside the truth (PNG).", callback=writable_folder),
    ] = None,
    json_path: JsonFile = None,
) -> None:
    """Train a label head on PHOTOS, evaluate it on held-out sites, and install it if it is better.

    The calibration and the confusion of its labels are measured on the held-out photos and written with it. Unless
    --out is a path, the head goes to the user's models, and `label_head: NAME` of a camera selects it."""
    import platform
    import time
    from functools import partial

    import numpy as np
    from rich.console import Console

    from ltm_core.base.errors import ModelError
    from ltm_core.label_heads.head_trial import score_photos, teach_head, write_overlay
    from ltm_core.label_heads.labelled_frames import evenly, read_frames, without_classes
    from ltm_core.vision.label_head import (
        label_heads_folder,
        read_label_head,
        write_label_head,
    )
    from ltm_core.vision.manifest import DEFAULT_MODEL, NetworkManifest, Withdrawal
    from ltm_core.vision.segmenter import Segmenter
    from ltm_ros.pages import write_figures

    console, start = Console(), time.perf_counter()
    segmenter = Segmenter(NetworkManifest.find(model or DEFAULT_MODEL).serving(out), threads)
    manifest, names = segmenter.manifest, segmenter.labels.names
    path = Path(out) if out.endswith((".yaml", ".yml")) else label_heads_folder(manifest) / f"{out}.yaml"
    left_out = [segmenter.labels.id_of(n.strip()) for n in ignore.split(",") if n.strip()]
    frames = without_classes(read_frames(photos, len(names)), left_out)
    made = f"ltm train head {photos.resolve().name}, {len(frames)} photos, numpy {np.__version__}"
    tag = f"{path.stem}_held_out"
    look = partial(write_overlay, overlays, tag, segmenter.labels) if overlays is not None else lambda *_: None
    rules = Withdrawal(confidence=confidence, tree_contrast=tree_contrast)
    with console.status("teaching"):
        trial = teach_head(segmenter, frames, path.stem, made, licence, rules, one_view, look)
    conditions = f"{platform.machine()}, {threads} threads, network {segmenter.described}"
    console.print(
        f"{len(frames)} photos of {', '.join(trial.sites)}; held out {trial.folds}; {conditions}", highlight=False
    )
    scores = {"the network": trial.before, f"head {path.stem}, held out": trial.after}
    console.print(score_table(names, scores, f"{photos}: heads trained on the other sites"))
    for name, score in scores.items():
        console.print(confusion_table(names, score.labels, name))
    part = path.with_name(f".{path.name}.part")
    write_label_head(part, trial.file)
    figures = {"photos": {name: score.summary(names) for name, score in scores.items()}}
    try:
        taught = Segmenter(manifest, threads, segmenter.labels, head=read_label_head(part, manifest)[0])
        for folder in also or []:
            others = evenly(read_frames(folder, len(names), sampled=True), limit)
            both = {"the network": segmenter, f"head {path.stem}": taught}
            elsewhere = {name: score_photos([one] * len(others), others) for name, one in both.items()}
            console.print(score_table(names, elsewhere, f"{folder}, {len(others)} frames: loss at other places"))
            figures[folder.resolve().name] = {name: score.summary(names) for name, score in elsewhere.items()}
        if json_path is not None:
            write_figures(json_path, figures)
        seconds = time.perf_counter() - start
        if not trial.better:
            raise ModelError(
                f"head {path.stem!r} is not installed: its macro F1 on held-out photos is "
                f"{trial.after.macro_f1:.3f}, that of the network alone {trial.before.macro_f1:.3f}; label photos "
                "of more sites, with every class"
            )
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    console.print(
        f"macro F1 {trial.before.macro_f1:.3f} -> {trial.after.macro_f1:.3f} in {seconds:.0f} s; written: {path}, "
        f"{path.stat().st_size / 1000:.1f} kB. To use it, set `label_head: {path.stem}` of a camera in the site "
        "file",
        highlight=False,
    )


train = typer.Typer(no_args_is_help=True, help="Train a label head for your site from a few labelled photos.")


@train.callback()
def _commands() -> None:
    """Keep `head` a subcommand while it is the only one."""


train.command()(head)
