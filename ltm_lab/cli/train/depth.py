"""`ltm-lab train depth`: gives a network of labels the depth of another one, so that one encoder serves both."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_ros.cli.output import writable_folder

if TYPE_CHECKING:
    from ltm_lab.training.labelled_frames import Frame


def depth(
    labels: Annotated[str, typer.Argument(help="Network of `ltm train` whose labels stay as they are.")],
    teacher: Annotated[str, typer.Argument(help="Network of `ltm train` whose depth is learnt.")],
    photos: Annotated[
        list[Path],
        typer.Option("--photos", help="Folder of photos or of rendered frames to learn on; may be given again."),
    ],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the model.", callback=writable_folder)],
    judged: Annotated[
        list[Path] | None, typer.Option("--judged", help="Folder of photos that judge; may be given again.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the network; default: <LABELS>_one.")] = None,
    windows: Annotated[
        int, typer.Option(min=1, help="Changed copies of photos to learn on, 1.4 MB of memory each.")
    ] = 2000,
    steps: Annotated[int, typer.Option(min=1, help="Training steps.")] = 3000,
    batch: Annotated[int, typer.Option(min=1, help="Windows a step.")] = 8,
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 2,
) -> None:
    """Teach a depth pyramid of its own to LABELS, to say what TEACHER does: one run of one file then gives both.

    Photos need no truth; of rendered frames theirs is learnt, too. Labels stay as they are; heads that were taught for
    LABELS must be taught again.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
    from rich.table import Table

    from ltm_core.storage.photo_io import photos_in, read_rgb
    from ltm_core.vision.labels import LabelSet
    from ltm_core.vision.manifest import NetworkManifest
    from ltm_lab.cli.train.training_run import need_torch

    need_torch()
    import numpy as np
    import torch

    from ltm_lab.training.depth_pyramid import DepthPyramidConfig, differences, joined, with_depth_of
    from ltm_lab.training.export import export_adapted
    from ltm_lab.training.exported import load_exported

    console, base, of = Console(), NetworkManifest.find(labels), NetworkManifest.find(teacher)
    network, source = load_exported(base), load_exported(of)
    config = DepthPyramidConfig(
        windows=windows, steps=steps, batch=batch, width=base.input.width, height=base.input.height
    )
    taught = [frame for folder in photos for frame in _frames(folder)]
    torch.set_num_threads(threads)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("", total=windows + steps)
        found = with_depth_of(
            network,
            source,
            taught,
            config,
            lambda done, loss: bar.update(
                task, completed=done, description="windows" if np.isnan(loss) else f"loss {loss:.3f}"
            ),
        )
    table = Table(
        title=f"mean |log ratio| of depth to that of {of.name}, land alone: median, 90th percentile of photos"
    )
    for column in ("photos", "", "own depth before", "the other's pyramid as it is", "taught"):
        table.add_column(column, justify="left" if column == "photos" else "right")
    for folder in judged or []:
        pictures = [read_rgb(photo) for photo in photos_in(folder)]
        shares = [differences(one, source, pictures, config) for one in (network, joined(network, source), found)]
        table.add_row(
            str(folder), str(len(pictures)), *(f"{np.median(s):.3f} {np.percentile(s, 90):.3f}" for s in shares)
        )
    if judged:
        console.print(table)
    why = f"{base.name}, with the depth of {of.name} by `ltm-lab train depth`"
    written = export_adapted(found, base, name or f"{base.name}_one", LabelSet.load(), out, why)
    console.print(f"{len(taught)} photos taught; wrote {written} and {written.stem}_depth.yaml, of one file")


def _frames(folder: Path) -> list[Frame]:
    """With labels and depth where the folder has them."""
    import numpy as np

    from ltm_core.storage.photo_io import photos_in, read_rgb
    from ltm_core.vision.labels import LabelSet
    from ltm_lab.training.labelled_frames import UNKNOWN, Frame, holds_frames, read_frames

    if holds_frames(folder):
        return read_frames(folder, len(LabelSet.load()))
    photos = [(read_rgb(path), path) for path in photos_in(folder)]
    return [Frame(photo, np.full(photo.shape[:2], UNKNOWN, np.uint8), path) for photo, path in photos]
