"""`ltm models`: list, check and add networks."""

from __future__ import annotations

import time
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.storage.disk_io import require_folder
from ltm_ros.cli.output import print_table

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID

    from ltm_core.base.types import UInt8Array
    from ltm_core.depth.monocular import NetworkDepth
    from ltm_core.vision.manifest import NetworkManifest
    from ltm_core.vision.segmenter import Segmenter


_SHOWN = 12
"""Maximum number of unlabelled classes that are printed."""


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
    name: Annotated[
        str | None, typer.Argument(help="Model name or manifest; with add: ONNX file, folder, manifest or recipe.")
    ] = None,
    recordings: Annotated[
        list[Path] | None, typer.Argument(help="Recordings of the site from before any change (measure).")
    ] = None,
    site: Annotated[Path | None, typer.Option(help="Site file with a prior fuel map (measure).")] = None,
    photos: Annotated[Path | None, typer.Option(help="Folder of labelled photos (measure).")] = None,
    images: Annotated[Path | None, typer.Option(help="Photo or folder of photos to run on (check, add).")] = None,
    classes: Annotated[
        str | None, typer.Option(help='Prompts for a network of text: "dry grass, chaparral, oak" (check).')
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for images (check, add).")] = Path("out/models"),
    fetch: Annotated[bool, typer.Option("--fetch", help="Download the file from the manifest's URL (add).")] = False,
    named: Annotated[str, typer.Option("--name", help="Name of the model; default: that of its file (add).")] = "",
    stated: Annotated[
        list[str] | None, typer.Option("--set", help="Key of the manifest, as output.kind=metric; repeatable (add).")
    ] = None,
    like: Annotated[str, typer.Option(help="Recipe whose properties the file has (add).")] = "",
) -> None:
    """List the networks, check one (shapes, time, images), install one, or measure its label errors."""
    from rich.console import Console

    console = Console()
    if action is Action.list:
        _list(console)
        return
    from ltm_core.vision.manifest import DEFAULT_MODEL, NetworkManifest

    if action is Action.measure:
        _measure(console, name or DEFAULT_MODEL, site, recordings or [], photos)
        return
    require_folder(out)
    if action is Action.check:
        _check(console, NetworkManifest.find(name or DEFAULT_MODEL), images, out, classes)
        return
    if name is None:
        raise ConfigError("give the network to add: ltm models add model.onnx (or its folder, a manifest, or a recipe)")
    _add(console, name, fetch, named, stated or [], like, images, out)


def _add(
    console: Console, given: str, fetch: bool, name: str, options: list[str], like: str, images: Path | None, out: Path
) -> None:
    """Determine the manifest of a network, run the network on photos, and then copy it."""
    from rich.progress import Progress

    from ltm_core.vision.install_io import install, source_of, stated_by
    from ltm_core.vision.recognition import recognise

    with Progress(console=console, transient=True) as bar:
        task = bar.add_task("downloading", total=None)
        source = source_of(given, lambda received: bar.update(task, completed=received), fetch)
        with source as found:
            bar.stop()
            manifest = recognise(found, stated_by(options), like, name)
            _check(console, manifest, images, out)
            added = install(manifest, found)
    role = "depth_model" if added.output.is_depth else "model"
    unmapped = [each for each in added.classes if each not in added.mapping]
    if unmapped:
        shown = ", ".join(unmapped[:_SHOWN]) + (", ..." if len(unmapped) > _SHOWN else "")
        console.print(f"{len(unmapped)} of {len(added.classes)} classes have no label: {shown}", markup=False)
    console.print(f"licence: {added.licence}", markup=False, highlight=False)
    console.print(
        f"added {added.name} to {added.folder}; use it as `{role}: {added.name}` in a site file", markup=False
    )


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
            found = measure_network(name, site, recordings, photos, head, partial(_advance, bar, task))
        right = np.diagonal(found.errors.shares)
        text = ", ".join(f"{f.name.lower()} {right[f - 1]:.0%}" for f in LifeForm if np.isfinite(right[f - 1]))
        console.print(f"{name}, label head {head}: {found.errors.state}; right labels: {text}", highlight=False)
        alike = ", ".join(f"{key} {value:.2f}" for key, value in found.errors.correlation.model_dump().items())
        console.print(f"correlation of errors: {alike}\n{found.path}", highlight=False, markup=False)


def _list(console: Console) -> None:
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
    _list_recipes(console)


def _list_recipes(console: Console) -> None:
    from ltm_core.vision.install_io import RecipeFile

    known = RecipeFile.load().recipes
    rows = [
        (name, "ltm models add" if recipe.url else "export it", recipe.licence, recipe.page)
        for name, recipe in known.items()
    ]
    print_table(console, "", ("recipe", "file", "licence", "page"), rows)


def _check(
    console: Console, manifest: NetworkManifest, images: Path | None, out: Path, classes: str | None = None
) -> None:
    """Print the model's input, output and running time; write images.

    With `classes`, comma-separated prompts replace the model's classes. Without `images`, a drawn scene is used."""
    from ltm_core.storage.image_io import photos_in, read_rgb
    from ltm_core.vision.overlays import scene_of

    photos = [(path, scene_of(read_rgb(path))) for path in photos_in(images)] if images is not None else []
    photos = photos or [(Path("trial_scene"), trial_scene())]
    spec, kind = manifest.input, manifest.output.kind
    console.print(f"{manifest.name}: {manifest.model_file()}; sha256 {manifest.sha256[:12]}...", markup=False)
    console.print(f"input {spec.layout} {spec.dtype} {spec.shape} {spec.fit}; output {kind}", markup=False)
    if manifest.output.is_depth:
        _check_depth(console, manifest, photos, out)
    else:
        _check_labels(console, manifest, photos, out, classes)


def _check_labels(
    console: Console, manifest: NetworkManifest, photos: list[tuple[Path, UInt8Array]], out: Path, classes: str | None
) -> None:
    from ltm_core.vision.prompts import labels_of_prompts, prompted
    from ltm_core.vision.segmenter import Segmenter

    labels = None if classes is None else labels_of_prompts(classes)
    segmenter = Segmenter(manifest if labels is None else prompted(manifest, {}, labels), 1, labels)
    for path, photo in photos:
        _overlay(console, segmenter, photo, path, out)


def _check_depth(console: Console, manifest: NetworkManifest, photos: list[tuple[Path, UInt8Array]], out: Path) -> None:
    """Print the depth and running time of a depth model; write images (red near, blue far)."""
    import numpy as np

    from ltm_core.depth.monocular import DepthNetwork
    from ltm_core.geometry.camera import Camera
    from ltm_core.pictures import to_jpeg

    network = DepthNetwork(manifest)
    for path, photo in photos:
        camera = Camera.from_fov(photo.shape[1], photo.shape[0], 50.0)
        network.predict(photo, camera)
        start = time.perf_counter()
        found = network.predict(photo, camera)
        milliseconds = (time.perf_counter() - start) * 1e3
        if not np.isfinite(found.values).any():
            raise ModelError(
                f"model {manifest.name!r}: no pixel of {path.name} has a depth; the network or its kind is wrong"
            )
        target = out / f"{path.stem}_{manifest.name}.jpg"
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(to_jpeg(np.vstack([photo, _depth_colors(found, photo.shape[:2])])))
        spread = f"{np.nanmin(found.values):.4g}..{np.nanmax(found.values):.4g}"
        console.print(f"{path.name}: {found.kind} {spread}, {milliseconds:.0f} ms -> {target}")


def trial_scene() -> UInt8Array:
    """Return a drawn scene (360, 640, 3) with sky, two ridges and a meadow, for tests without a photo."""
    import cv2
    import numpy as np

    rng = np.random.default_rng(5)
    height, width = 360, 640
    rows, cols = np.mgrid[0:height, 0:width]
    scene = np.array([120, 165, 215]) + rows[..., None] * np.array([0.16, 0.12, 0.06])
    rough = cv2.resize(rng.normal(0.0, 1.0, (height // 3, width // 3)), (width, height))[..., None]
    far = rows > 120 + 35 * np.sin(cols / 90.0) + 12 * np.sin(cols / 23.0)
    near = rows > 190 + 30 * np.cos(cols / 120.0) + 4 * np.sin(cols / 7.0)
    meadow = rows > 270 + cols / 30.0
    for part, color, contrast in ((far, (105, 120, 130), 6), (near, (52, 66, 38), 18), (meadow, (176, 160, 96), 14)):
        scene = np.where(part[..., None], np.array(color) + contrast * rough, scene)
    return np.asarray(np.clip(scene, 0, 255), np.uint8)


def _depth_colors(found: NetworkDepth, size: tuple[int, ...]) -> UInt8Array:
    """Return the ranks of a depth image as colours."""
    import cv2
    import numpy as np

    values = found.values if found.kind == "relative_inverse" else -found.values
    ranks = np.searchsorted(np.sort(values[np.isfinite(values)]), values) / values.size * 255.0
    large = cv2.resize(np.nan_to_num(ranks).astype(np.uint8), size[::-1], interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(cv2.applyColorMap(np.asarray(large, np.uint8), cv2.COLORMAP_TURBO)[..., ::-1])


def _overlay(console: Console, segmenter: Segmenter, photo: UInt8Array, path: Path, out: Path) -> None:
    import numpy as np

    from ltm_core.pictures import label_legend, overlay_labels, to_jpeg, with_legend

    segmenter.segment(photo)  # loads the network
    start = time.perf_counter()
    labels = segmenter.segment(photo).labels
    milliseconds = (time.perf_counter() - start) * 1e3
    shares = np.bincount(labels.ravel(), minlength=256) / labels.size
    seen = [int(label) for label in np.argsort(-shares) if shares[label] >= 0.01]
    legend = label_legend(photo.shape[1], segmenter.labels, seen)
    target = out / f"{path.stem}_{segmenter.manifest.name}.jpg"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(to_jpeg(with_legend(overlay_labels(photo, labels, segmenter.labels), legend)))
    text = ", ".join(f"{segmenter.labels.name_of(label)} {shares[label]:.0%}" for label in seen)
    console.print(f"{path.name} ({photo.shape[1]} x {photo.shape[0]}): {text}, {milliseconds:.0f} ms -> {target}")
