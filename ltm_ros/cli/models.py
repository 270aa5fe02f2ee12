"""`ltm models`: lists the installed networks, tries one of them, or adds one."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from ltm_core.vision.manifest import Manifest


class Action(StrEnum):
    """What `ltm models` does."""

    list = "list"
    check = "check"
    add = "add"


def models(
    action: Annotated[
        Action, typer.Argument(help="list: all manifests; check: run one on photos; add: take one over.")
    ] = Action.list,
    name: Annotated[str | None, typer.Argument(help="Model name (check) or path of a manifest (check, add).")] = None,
    images: Annotated[Path | None, typer.Option(help="Photo or folder of photos to run on (check).")] = None,
    classes: Annotated[
        str | None, typer.Option(help='Look for these words instead: "dry grass, chaparral, oak, road" (check).')
    ] = None,
    frames: Annotated[
        Path | None, typer.Option(help="Folder of NNNN.png with NNNN_labels.png to score on (check).")
    ] = None,
    sky_masks: Annotated[
        Path | None, typer.Option(help="Folder of <photo>_mask.* (white: not sky) to score the sky on (check).")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for pictures (check, add).")] = Path("out/models"),
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 1,
    zoom: Annotated[float, typer.Option(help="Second look at distant slopes, so much larger (check).")] = 1.0,
    fetch: Annotated[bool, typer.Option("--fetch", help="Download the file from the manifest's URL (add).")] = False,
) -> None:
    """List the networks, check one (shapes, time, pictures, scores), or add one to those found by name."""
    from rich.console import Console

    console = Console()
    if action is Action.list:
        _list(console)
        return
    from ltm_core.errors import ConfigError
    from ltm_core.output_io import require_folder
    from ltm_core.vision.default_networks import DEFAULT_MODEL
    from ltm_core.vision.manifest import Manifest
    from ltm_ros.cli.models_check import check, check_depth

    require_folder(out)
    manifest = Manifest.find(name or DEFAULT_MODEL)
    if action is Action.add:
        if name is None:
            raise ConfigError("name the manifest to add: ltm models add my_network.yaml")
        manifest = _add(console, Path(name), fetch)
    if manifest.output.is_depth:
        check_depth(console, manifest, threads, images, out)
    else:
        check(console, manifest, threads, images, frames, sky_masks, out, classes=classes, zoom=zoom)


def _add(console: Console, path: Path, fetch: bool) -> Manifest:
    from rich.progress import Progress

    from ltm_core.vision.install_io import add_model

    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("fetching", total=None)
        added = add_model(path, fetch, lambda received: bar.update(task, completed=received))
    console.print(f"added {added.name} to {added.folder}; use it as `model: {added.name}` in a site file", markup=False)
    return added


def _list(console: Console) -> None:
    from rich.table import Table

    from ltm_core.errors import ModelError
    from ltm_core.vision.default_networks import DEFAULT_MODEL
    from ltm_core.vision.manifest import Manifest, added_names, shipped_names
    from ltm_core.vision.onnx_model import OnnxModel

    table = Table("model", "input", "output", "licence", "sha256", "state")
    faults = []
    for name in [*shipped_names(), *added_names()]:
        try:
            manifest = Manifest.find(name)
        except ModelError as reason:
            table.add_row(name, "", "", "", "", "[red]not usable[/red]")
            faults.append(str(reason))
            continue
        try:
            path = OnnxModel(manifest).path
            state = f"[green]ready[/green], {path.stat().st_size / 1e6:.1f} MB"
        except ModelError as reason:
            state = "[red]not usable[/red]"
            faults.append(str(reason))
        spec, output = manifest.input, manifest.output
        what = f", {len(manifest.classes)} classes" if manifest.classes else ""
        table.add_row(
            f"{name} (default)" if name == DEFAULT_MODEL else name,
            f"{spec.width} x {spec.height} {spec.dtype}",
            output.kind + (", of words" if manifest.text is not None else what),
            manifest.licence,
            manifest.sha256[:12],
            state,
        )
    console.print(table)
    for fault in faults:
        console.print(fault, markup=False, highlight=False)
