"""`ltm-lab train built`: teaches a network masts, huts, dishes and roofs, by some that are drawn into photos."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import writable_folder


def built(
    network: Annotated[str, typer.Argument(help="Network of `ltm train`; but for `built` its labels stay.")],
    photos: Annotated[
        list[Path], typer.Option("--photos", help="Folder of labelled photos to draw into; may be given again.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the model.", callback=writable_folder)],
    judged: Annotated[
        list[Path] | None, typer.Option("--judged", help="Folder of labelled frames that judge; may be given again.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the network; default: <NETWORK>_built.")] = None,
    draws: Annotated[int, typer.Option(min=1, help="Copies of each photo with structures drawn into them.")] = 4,
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 2,
) -> None:
    """Give NETWORK's coarser maps a say in the score of `built`, taught by structures drawn into photos.

    Depth and the scores of the other classes stay as they are; heads that were taught for NETWORK must be taught again.
    """
    from rich.console import Console

    from ltm_core.vision.labels import LabelSet
    from ltm_core.vision.manifest import NetworkManifest
    from ltm_core.vision.segmenter import Segmenter
    from ltm_lab.cli.eval.segmentation_tables import score_table
    from ltm_lab.cli.train.training_run import need_torch
    from ltm_lab.evaluation.segmentation.network_score import score_frames
    from ltm_lab.training.labelled_frames import read_frames

    need_torch()
    from ltm_lab.training.export import export_adapted
    from ltm_lab.training.exported import load_exported, with_cue
    from ltm_lab.training.structure_cue import CueConfig, cue_samples, fit_cue

    console, base, labels = Console(), NetworkManifest.find(network), LabelSet.load()
    weights, config = load_exported(base), CueConfig(draws=draws)
    before = Segmenter(base, threads, labels)
    taught = [frame for folder in photos for frame in read_frames(folder, len(labels))]
    with console.status("drawing"):
        samples = cue_samples(before, taught, config)
    with console.status("teaching"):
        found = with_cue(weights, fit_cue(samples, base.maps, config))
    why = f"{base.name}, taught what is built by `ltm-lab train built`"
    written = export_adapted(found, base, name or f"{base.name}_built", labels, out, why)
    after = Segmenter.open(written, threads, labels)
    for folder in judged or []:
        frames = read_frames(folder, len(labels), sampled=True)
        scores = {"before": score_frames(before, frames), "after": score_frames(after, frames)}
        console.print(score_table(labels.names, scores, f"{folder}, {len(frames)} frames"))
    console.print(f"{len(taught)} photos, {draws} drawn copies of each; wrote {written}", highlight=False)
