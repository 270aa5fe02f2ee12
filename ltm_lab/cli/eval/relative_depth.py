"""`ltm-lab eval relative-depth`: compares networks of relative depth on frames of known depth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ltm_ros.cli.output import JsonFile


def relative_depth(
    folder: Annotated[Path, typer.Argument(help="Folder of `ltm-lab simulate`, or of several such folders.")],
    model: Annotated[list[str] | None, typer.Option("--model", help="Model name or manifest; again for more.")] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="At most so many frames of a folder, evenly chosen.")] = None,
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 1,
    json_path: JsonFile = None,
) -> None:
    """Score networks alone, without terrain: AbsRel by range after a robust fit of scale and shift to the true depth
    (RANSAC, the same for every network), and how many pairs of pixels are in order of near and far."""
    from dataclasses import asdict

    from rich.console import Console
    from rich.table import Table

    from ltm_core.base.errors import RecordingError
    from ltm_core.base.evenly import evenly
    from ltm_core.depth.monocular import DepthNetwork
    from ltm_core.vision.labels import LabelSet
    from ltm_core.vision.manifest import DEFAULT_DEPTH_MODEL
    from ltm_lab.evaluation.depth.relative_depth import bin_names, score_relative_depth
    from ltm_lab.evaluation.figures_io import write_figures
    from ltm_lab.training.training_frames import read_training_frames

    places = [folder] if (folder / "frames.json").is_file() else sorted(p.parent for p in folder.glob("*/frames.json"))
    if not places:
        raise RecordingError(f"{folder}: no frames.json; expected a folder of `ltm-lab simulate`, or folders of them")
    networks = [DepthNetwork.open(name, threads) for name in model or [DEFAULT_DEPTH_MODEL, "tcmonodepth"]]
    console, labels = Console(), LabelSet.load()
    result: dict[str, object] = {}
    for place in places:
        frames = read_training_frames(place, len(labels), sampled=True)
        if limit is not None:
            frames = evenly(frames, limit)
        scores = {network.manifest.name: score_relative_depth(network, frames) for network in networks}
        one = next(iter(scores.values()))
        table = Table(
            title=f"{place}: AbsRel of {one.frames} frames",
            caption="after a RANSAC fit of scale and shift to the truth; order: of pairs, one pixel half as far "
            "again as the other or more",
        )
        table.add_column("range")
        table.add_column("pixels", justify="right")
        for name in scores:
            table.add_column(name, justify="right", overflow="fold")
        for i, name in enumerate(bin_names()):
            table.add_row(name, str(one.pixels[i]), *(f"{score.abs_rel[i]:.3f}" for score in scores.values()))
        table.add_row("in order", "", *(f"{score.order:.1%}" for score in scores.values()))
        table.add_row("frames without a fit", "", *(str(score.unfit) for score in scores.values()))
        console.print(table)
        result[place.name] = {name: asdict(score) for name, score in scores.items()}
    if json_path is not None:
        write_figures(json_path, {"ranges": bin_names(), "sets": result})
