"""`ltm train head`: teaches a label network a kind of place from a few photos in which a person named areas."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_core.vision.manifest import DEFAULT_MODEL
from ltm_ros.cli.output import JsonFile, writable_folder


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
    from ltm_core.scoring.overlays_io import write_overlay
    from ltm_core.vision.label_head import (
        label_heads_folder,
        read_label_head,
        write_label_head,
    )
    from ltm_core.vision.manifest import NetworkManifest, Withdrawal
    from ltm_core.vision.segmenter import Segmenter
    from ltm_ros.cli.train_head_tables import confusion_table, score_table
    from ltm_ros.pages.figures_io import write_figures

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
