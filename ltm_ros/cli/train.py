"""`ltm train head`: teach a label network what grows at a site, from a few labelled photos."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.table import Table

from ltm_core.vision.manifest import DEFAULT_MODEL
from ltm_ros.cli.output import JsonFile, writable_folder

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


def head(
    photos: Annotated[
        Path,
        typer.Argument(
            help="Folder of photos with NAME_labels.png or polygons.json; sites.csv or NAME up to _ is the site."
        ),
    ],
    out: Annotated[str, typer.Option("--out", "-o", help="Name of the head, or the path of its file (.yaml).")],
    model: Annotated[str, typer.Option(help="The network, or one that takes its heads.")] = DEFAULT_MODEL,
    also: Annotated[
        list[Path] | None,
        typer.Option(help="Labelled frames of other places: what the head forgets there; again for more."),
    ] = None,
    one_view: Annotated[
        bool, typer.Option("--one-view", help="PHOTOS are of one view, and the head is for that alone.")
    ] = False,
    limit: Annotated[int, typer.Option(min=1, help="At most so many frames of each --also, evenly chosen.")] = 24,
    licence: Annotated[str, typer.Option(help="Of the photos, for the head's file.")] = "",
    threads: Annotated[int, typer.Option(help="CPU threads of the network.")] = 1,
    ignore: Annotated[
        str, typer.Option(help="True classes that neither teach nor count, with commas.", metavar="CLASSES")
    ] = "",
    confidence: Annotated[
        float, typer.Option(min=0, max=0.99, help="The head leaves pixels of lower probability unlabelled.")
    ] = 0.4,
    tree_contrast: Annotated[
        float, typer.Option(min=0, help="The head withdraws tree of lower contrast, 8-bit steps, among more shrub.")
    ] = 0.0,
    ridge: Annotated[
        float,
        typer.Option(
            min=1e-6, help="Penalty on what coarse maps say of the classes: less for photos of dozens of places."
        ),
    ] = 1.0,
    rarity: Annotated[
        float, typer.Option(min=0, max=1, help="A class counts in a photo as its area's share to this power.")
    ] = 0.8,
    overlays: Annotated[
        Path | None,
        typer.Option(help="Draw the answer to each photo held out beside its truth, PNG.", callback=writable_folder),
    ] = None,
    json_path: JsonFile = None,
) -> None:
    """Teach a head to PHOTOS, judge it by sites that did not teach it, and install it where it is better.

    How sure its labels are and how they err is measured on the photos held out, and written with it. Without --out as a
    path it is kept among the user's own models, where a camera's `label_head: NAME` finds it.
    """
    import platform
    import time
    from functools import partial

    import numpy as np
    from rich.console import Console

    from ltm_core.base.errors import ModelError
    from ltm_core.base.evenly import evenly
    from ltm_core.label_heads.head_fit import HeadFitConfig
    from ltm_core.label_heads.head_trial import score_photos, teach_head
    from ltm_core.label_heads.labelled_frames import read_frames, without_classes
    from ltm_core.pictures.photo_overlays import write_overlay
    from ltm_core.vision.label_head import (
        label_heads_folder,
        read_label_head,
        write_label_head,
    )
    from ltm_core.vision.manifest import NetworkManifest, Withdrawal
    from ltm_core.vision.segmenter import Segmenter
    from ltm_ros.pages.render import write_figures

    console, start = Console(), time.perf_counter()
    segmenter = Segmenter(NetworkManifest.find(model).serving(out), threads)
    manifest, names = segmenter.manifest, segmenter.labels.names
    path = Path(out) if out.endswith((".yaml", ".yml")) else label_heads_folder(manifest) / f"{out}.yaml"
    left_out = [segmenter.labels.id_of(n.strip()) for n in ignore.split(",") if n.strip()]
    frames = without_classes(read_frames(photos, len(names)), left_out)
    made = f"ltm train head {photos.resolve().name}, {len(frames)} photos, numpy {np.__version__}"
    tag = f"{path.stem}_held_out"
    look = partial(write_overlay, overlays, tag, segmenter.labels) if overlays is not None else lambda *_: None
    rules, fit = (
        Withdrawal(confidence=confidence, tree_contrast=tree_contrast),
        HeadFitConfig(ridge=ridge, rarity=rarity),
    )
    with console.status("teaching"):
        trial = teach_head(segmenter, frames, path.stem, made, licence, rules, one_view, look, fit)
    conditions = f"{platform.machine()}, {threads} threads, network {segmenter.described}"
    console.print(
        f"{len(frames)} photos of {', '.join(trial.sites)}; held out {trial.folds}; {conditions}", highlight=False
    )
    scores = {"the network": trial.before, f"head {path.stem}, held out": trial.after}
    console.print(score_table(names, scores, f"{photos}: by heads that the other sites taught"))
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
            console.print(score_table(names, elsewhere, f"{folder}, {len(others)} frames: what the head forgets"))
            figures[folder.resolve().name] = {name: score.summary(names) for name, score in elsewhere.items()}
        if json_path is not None:
            write_figures(json_path, figures)
        seconds = time.perf_counter() - start
        if not trial.better:
            raise ModelError(
                f"head {path.stem!r} is not installed: on photos that did not teach it its macro F1 is "
                f"{trial.after.macro_f1:.3f}, the network's own {trial.before.macro_f1:.3f}; name areas in photos of "
                "more sites, and of every class"
            )
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    console.print(
        f"macro F1 {trial.before.macro_f1:.3f} -> {trial.after.macro_f1:.3f} in {seconds:.0f} s; written: {path}, "
        f"{path.stat().st_size / 1000:.1f} kB. A camera takes it by `label_head: {path.stem}` in the site file",
        highlight=False,
    )


train = typer.Typer(no_args_is_help=True, help="Teach a label network a place from a few labelled photos.")


@train.callback()
def _commands() -> None:
    """Keep `head` a command of its own while it is the only one."""


train.command()(head)
