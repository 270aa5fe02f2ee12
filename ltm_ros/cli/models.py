"""`ltm models`: list, check and add networks."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from ltm_ros.cli.output import print_table

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from ltm_core.vision.manifest import NetworkManifest


class Action(StrEnum):
    """Action of `ltm models`."""

    list = "list"
    check = "check"
    add = "add"
    measure = "measure"


def models(
    action: Annotated[
        Action, typer.Argument(help="list: all manifests; check: run one; add: install one; measure: its errors.")
    ] = Action.list,
    name: Annotated[str | None, typer.Argument(help="Model name or path of a manifest.")] = None,
    recordings: Annotated[
        list[Path] | None, typer.Argument(help="Recordings of the site from before any change (measure).")
    ] = None,
    site: Annotated[Path | None, typer.Option(help="Site file with a prior fuel map (measure).")] = None,
    photos: Annotated[Path | None, typer.Option(help="Folder of labelled photos (measure).")] = None,
    images: Annotated[Path | None, typer.Option(help="Photo or folder of photos to run on (check).")] = None,
    classes: Annotated[
        str | None, typer.Option(help='Classes given as words: "dry grass, chaparral, oak, road" (check).')
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for images (check, add).")] = Path("out/models"),
    threads: Annotated[int, typer.Option(help="CPU threads.")] = 1,
    zoom: Annotated[float, typer.Option(help="Magnification of a second pass over distant slopes (check).")] = 1.0,
    fetch: Annotated[bool, typer.Option("--fetch", help="Download the file from the manifest's URL (add).")] = False,
) -> None:
    """List the networks, check one (shapes, time, images), install one by its manifest, or measure its label errors."""
    from rich.console import Console

    console = Console()
    if action is Action.list:
        _list(console)
        return
    from ltm_core.base.errors import ConfigError
    from ltm_core.storage.disk_io import require_folder
    from ltm_core.vision.manifest import DEFAULT_MODEL, NetworkManifest
    from ltm_ros.cli.models_check import check, check_depth

    if action is Action.measure:
        _measure(console, name or DEFAULT_MODEL, site, recordings or [], photos)
        return
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


def _advance(bar: Progress, task: TaskID, done: int, of: int) -> None:
    bar.update(task, completed=done, total=of)


def _measure(console: Console, name: str, path: Path | None, recordings: list[Path], photos: Path | None) -> None:
    from functools import partial

    import numpy as np
    from rich.progress import Progress

    from ltm_core.fuel.life_form import LifeForm
    from ltm_core.site.site_io import load_site
    from ltm_core.vision.manifest import SHIPPED_LABEL_HEAD
    from ltm_ros.recordings.measured_network import measure_network

    site = None if path is None else load_site(path)
    heads = {SHIPPED_LABEL_HEAD} if site is None else {camera.label_head for camera in site.cameras.values()}
    for head in sorted(heads):
        with Progress(console=console, transient=True) as bar:
            task = bar.add_task(f"measuring {name}", total=None)
            progress = partial(_advance, bar, task)
            found = measure_network(name, site, recordings, photos, head, progress)
        right = np.diagonal(found.errors.shares)
        text = ", ".join(f"{f.name.lower()} {right[f - 1]:.0%}" for f in LifeForm if np.isfinite(right[f - 1]))
        console.print(f"{name}, label head {head}: {found.errors.state}; right labels: {text}", highlight=False)
        alike = ", ".join(f"{key} {value:.2f}" for key, value in found.errors.correlation.model_dump().items())
        console.print(f"correlation of errors: {alike}\n{found.path}", highlight=False, markup=False)


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
