"""`ltm models`: which networks are at hand, and a trial of one of them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import Console


class Action(StrEnum):
    """What `ltm models` does."""

    list = "list"
    check = "check"


def models(
    action: Annotated[Action, typer.Argument(help="list: all manifests; check: run one on photos.")] = Action.list,
    name: Annotated[str | None, typer.Argument(help="Model name or path of a manifest (check).")] = None,
    images: Annotated[Path | None, typer.Option(help="Photo or folder of photos to run on (check).")] = None,
    frames: Annotated[
        Path | None, typer.Option(help="Folder of NNNN.png with NNNN_labels.png to score on (check).")
    ] = None,
    sky_masks: Annotated[
        Path | None, typer.Option(help="Folder of <photo>_mask.* (white: not sky) to score the sky on (check).")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for overlay pictures (check).")] = Path("out/models"),
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 1,
) -> None:
    """List the segmentation networks, or check one: shapes, time, overlay pictures, scores."""
    from rich.console import Console

    console = Console()
    if action is Action.list:
        _list(console)
        return
    from ltm_core.vision.segmenter import DEFAULT_MODEL, Segmenter
    from ltm_ros.cli.models_check import check

    check(console, Segmenter.open(name or DEFAULT_MODEL, threads), images, frames, sky_masks, out)


def _list(console: Console) -> None:
    from rich.table import Table

    from ltm_core.errors import ModelError
    from ltm_core.vision.manifest import Manifest, shipped_names
    from ltm_core.vision.onnx_model import OnnxModel
    from ltm_core.vision.segmenter import DEFAULT_MODEL

    table = Table("model", "input", "output", "licence", "state")
    faults = []
    for name in shipped_names():
        try:
            manifest = Manifest.find(name)
        except ModelError as reason:
            table.add_row(name, "", "", "", "[red]not usable[/red]")
            faults.append(str(reason))
            continue
        try:
            path = OnnxModel(manifest).path
            state = f"[green]ready[/green], {path.stat().st_size / 1e6:.1f} MB"
        except ModelError as reason:
            state = "[red]not usable[/red]"
            faults.append(str(reason))
        spec = manifest.input
        table.add_row(
            f"{name} (default)" if name == DEFAULT_MODEL else name,
            f"{spec.width} x {spec.height} {spec.dtype}",
            manifest.output.kind + ("" if manifest.output.is_depth else f", {len(manifest.classes)} classes"),
            manifest.licence,
            state,
        )
    console.print(table)
    for fault in faults:
        console.print(fault, markup=False, highlight=False)
