"""`ltm models`: list, check and add networks."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from ltm_ros.cli.output import print_table

if TYPE_CHECKING:
    from ltm_core.vision.manifest import NetworkManifest


class Action(StrEnum):
    """Action of `ltm models`."""

    list = "list"
    check = "check"
    add = "add"


def models(
    action: Annotated[
        Action, typer.Argument(help="list: all manifests; check: run one on photos; add: install one.")
    ] = Action.list,
    name: Annotated[str | None, typer.Argument(help="Model name (check) or path of a manifest (check, add).")] = None,
    images: Annotated[Path | None, typer.Option(help="Photo or folder of photos to run on (check).")] = None,
    classes: Annotated[
        str | None, typer.Option(help='Classes given as words: "dry grass, chaparral, oak, road" (check).')
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for images (check, add).")] = Path("out/models"),
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 1,
    zoom: Annotated[float, typer.Option(help="Magnification of a second pass over distant slopes (check).")] = 1.0,
    fetch: Annotated[bool, typer.Option("--fetch", help="Download the file from the manifest's URL (add).")] = False,
) -> None:
    """List the networks, check one (shapes, time, images), or install one by its manifest."""
    from rich.console import Console

    console = Console()
    if action is Action.list:
        _list(console)
        return
    from ltm_core.base.errors import ConfigError
    from ltm_core.storage.disk_io import require_folder
    from ltm_core.vision.manifest import DEFAULT_MODEL, NetworkManifest
    from ltm_ros.cli.models_check import check, check_depth

    require_folder(out)
    manifest = NetworkManifest.find(name or DEFAULT_MODEL)
    if action is Action.add:
        if name is None:
            raise ConfigError("give the manifest to add: ltm models add my_network.yaml")
        manifest = _add(console, Path(name), fetch)
    if manifest.output.is_depth:
        check_depth(console, manifest, threads, images, out)
    else:
        check(console, manifest, threads, images, out, classes=classes, zoom=zoom)


def _add(console: Console, path: Path, fetch: bool) -> NetworkManifest:
    from rich.progress import Progress

    from ltm_core.vision.install_io import add_model

    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("fetching", total=None)
        added = add_model(path, fetch, lambda received: bar.update(task, completed=received))
    console.print(f"added {added.name} to {added.folder}; use it as `model: {added.name}` in a site file", markup=False)
    return added


def _list(console: Console) -> None:
    from ltm_core.base.errors import ModelError
    from ltm_core.vision.manifest import DEFAULT_MODEL, NetworkManifest, added_names, shipped_names
    from ltm_core.vision.onnx_model import OnnxModel

    rows: list[tuple[str, ...]] = []
    faults = []
    for name in [*shipped_names(), *added_names()]:
        try:
            manifest = NetworkManifest.find(name)
        except ModelError as reason:
            rows.append((name, *[""] * 4, "[red]not usable[/red]"))
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
        rows.append(
            (
                f"{name} (default)" if name == DEFAULT_MODEL else name,
                f"{spec.width} x {spec.height} {spec.dtype}",
                output.kind + (", from words" if manifest.text is not None else what),
                manifest.licence,
                manifest.sha256[:12],
                state,
            )
        )
    print_table(console, "", ("model", "input", "output", "licence", "sha256", "state"), rows)
    for fault in faults:
        console.print(fault, markup=False, highlight=False)
