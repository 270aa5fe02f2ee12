"""`ltm models`: list, check and add networks."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import cv2
import numpy as np
from typer import Argument, Option

from ltm_core.base.errors import ConfigError, ModelError
from ltm_core.base.types import UInt8Array
from ltm_core.depth.monocular import DepthNetwork
from ltm_core.fuel.life_form import LifeForm
from ltm_core.geometry.camera import Camera
from ltm_core.pictures import label_legend, overlay_labels, to_jpeg, with_legend
from ltm_core.site.site_io import load_site
from ltm_core.storage.disk_io import require_folder
from ltm_core.storage.image_io import photos_in, read_rgb
from ltm_core.vision.install_io import RecipeFile, install, source_of, stated_by
from ltm_core.vision.manifest import DEFAULT_MODEL, SHIPPED_LABEL_HEAD, NetworkManifest, installed_names
from ltm_core.vision.onnx_model import OnnxModel
from ltm_core.vision.overlays import scene_of
from ltm_core.vision.recognition import recognise
from ltm_core.vision.segmenter import Segmenter
from ltm_ros.cli.output import Row, print_table, progress_bar, say, working
from ltm_ros.recordings.measured_network import measure_network

_SHOWN = 12
"""Maximum number of unlabelled classes that are printed."""
T = TypeVar("T")


def models(
    action: Annotated[
        Literal["list", "check", "add", "measure"],
        Argument(help="list: all manifests; check: run one; add: install one; measure: its errors."),
    ] = "list",
    name: Annotated[str | None, Argument(help="Model name or manifest; add: ONNX file, folder or recipe.")] = None,
    recordings: Annotated[list[Path] | None, Argument(help="Recordings from before any change (measure).")] = None,
    site: Annotated[Path | None, Option(help="Site file with a prior fuel map (measure).")] = None,
    photos: Annotated[Path | None, Option(help="Folder of labelled photos (measure).")] = None,
    images: Annotated[Path | None, Option(help="Photo or folder of photos to run on (check, add).")] = None,
    out: Annotated[Path, Option(help="Folder for images (check, add).")] = Path("out/models"),
    named: Annotated[str, Option("--name", help="Name of the model; default: that of its file (add).")] = "",
    stated: Annotated[list[str] | None, Option("--set", help="Key of the manifest: output.kind=metric (add).")] = None,
    like: Annotated[str, Option(help="Recipe whose properties the file has (add).")] = "",
) -> None:
    """List the networks, check one (shapes, time, images), install one, or measure its label errors."""
    if action == "list":
        _list()
        return
    if action == "measure":
        _measure(name or DEFAULT_MODEL, site, recordings or [], photos)
        return
    require_folder(out)
    if action == "check":
        _check(NetworkManifest.find(name or DEFAULT_MODEL), images, out)
        return
    if name is None:
        raise ConfigError("give the network to add: ltm models add model.onnx (or its folder, a manifest, or a recipe)")
    _add(name, named, stated or [], like, images, out)


def _add(given: str, name: str, options: list[str], like: str, images: Path | None, out: Path) -> None:
    """Determine the manifest of a network, run the network on photos, and then copy it."""
    status = working("downloading")
    with status, source_of(given, lambda received: status.update(f"{received / 1e6:.0f} MB")) as found:
        status.stop()
        manifest = recognise(found, stated_by(options), like, name)
        _check(manifest, images, out)
        added = install(manifest, found)
    role = "depth_model" if added.output.is_depth else "model"
    unmapped = [each for each in added.classes if each not in added.mapping]
    if unmapped:
        shown = ", ".join(unmapped[:_SHOWN]) + (", ..." if len(unmapped) > _SHOWN else "")
        say(f"{len(unmapped)} of {len(added.classes)} classes have no label: {shown}")
    say(f"licence: {added.licence}")
    say(f"added {added.name} to {added.folder}; use it as `{role}: {added.name}` in a site file")


def _measure(name: str, path: Path | None, recordings: list[Path], photos: Path | None) -> None:
    site = None if path is None else load_site(path)
    heads = {SHIPPED_LABEL_HEAD} if site is None else {camera.label_head for camera in site.cameras.values()}
    for head in sorted(heads):
        with progress_bar(f"measuring {name}") as progress:
            path, errors = measure_network(name, site, recordings, photos, head, progress)
        right = np.diagonal(errors.shares)
        text = ", ".join(f"{f.name.lower()} {right[f - 1]:.0%}" for f in LifeForm if np.isfinite(right[f - 1]))
        say(f"{name}, label head {head}: {errors.state}; right labels: {text}")
        alike = ", ".join(f"{key} {value:.2f}" for key, value in errors.correlation.model_dump().items())
        say(f"correlation of errors: {alike}\n{path}")


def _list() -> None:
    rows: list[Row] = []
    faults: list[str] = []
    for name in installed_names():
        cells, state = ["", "", "", ""], ("red", "not usable")
        try:
            manifest = NetworkManifest.find(name)
            spec, what = manifest.input, f", {len(manifest.classes)} classes" if manifest.classes else ""
            output = manifest.output.kind + (", from words" if manifest.text is not None else what)
            size = f"{spec.width} x {spec.height} {spec.dtype}"
            cells = [size, output, manifest.licence, manifest.sha256[:12]]
            state = "green", f"ready, {OnnxModel(manifest).path.stat().st_size / 1e6:.1f} MB"
        except ModelError as reason:
            faults.append(str(reason))
        rows.append((f"{name} (default)" if name == DEFAULT_MODEL else name, *cells, state))
    print_table("", ("model", "input", "output", "licence", "sha256", "state"), rows)
    for fault in faults:
        say(fault)
    recipes = RecipeFile.load().recipes.items()
    ways = [(key, "ltm models add" if one.url else "export it", one.licence, one.page) for key, one in recipes]
    print_table("", ("recipe", "file", "licence", "page"), ways)


def _check(manifest: NetworkManifest, images: Path | None, out: Path) -> None:
    """Print the model's input, output and running time; write images. Without `images`, a drawn scene is used."""
    photos = [(path, scene_of(read_rgb(path))) for path in photos_in(images)] if images is not None else []
    spec, kind = manifest.input, manifest.output.kind
    say(f"{manifest.name}: {manifest.model_file()}; sha256 {manifest.sha256[:12]}...")
    say(f"input {spec.layout} {spec.dtype} {spec.shape} {spec.fit}; output {kind}")
    depth = manifest.output.is_depth
    run = partial(_depth, DepthNetwork(manifest)) if depth else partial(_labels, Segmenter(manifest))
    for path, photo in photos or [(Path("trial_scene"), _trial_scene())]:
        target = out / f"{path.stem}_{manifest.name}.jpg"
        target.parent.mkdir(parents=True, exist_ok=True)
        text, picture = run(photo)
        target.write_bytes(to_jpeg(picture))
        say(f"{path.name} ({photo.shape[1]} x {photo.shape[0]}): {text} -> {target}")


def _timed(predict: Callable[[], T]) -> tuple[T, str]:
    """Run a network twice, because the first run loads it; return its result and the time of the second run."""
    predict()
    start = time.perf_counter()
    return predict(), f"{(time.perf_counter() - start) * 1e3:.0f} ms"


def _depth(network: DepthNetwork, photo: UInt8Array) -> tuple[str, UInt8Array]:
    """Run a depth network; return its result in words and as a picture (red near, blue far)."""
    found, spent = _timed(lambda: network.predict(photo, Camera.from_fov(photo.shape[1], photo.shape[0], 50.0)))
    known = found.values[np.isfinite(found.values)]
    if not known.size:
        raise ModelError(f"model {network.manifest.name!r}: no pixel has a depth; the network or its kind is wrong")
    near = found.values if found.kind == "relative_inverse" else -found.values
    ranks = np.searchsorted(np.sort(near[np.isfinite(near)]), near) / near.size * 255.0
    large = cv2.resize(np.nan_to_num(ranks).astype(np.uint8), photo.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    colors = cv2.applyColorMap(np.asarray(large, np.uint8), cv2.COLORMAP_TURBO)[..., ::-1]
    return f"{found.kind} {known.min():.4g}..{known.max():.4g}, {spent}", np.vstack([photo, colors])


def _labels(segmenter: Segmenter, photo: UInt8Array) -> tuple[str, UInt8Array]:
    """Run a segmentation network; return its result in words and as a picture."""
    segmented, spent = _timed(lambda: segmenter.segment(photo))
    labels = segmented.labels
    shares = np.bincount(labels.ravel(), minlength=256) / labels.size
    seen = [int(label) for label in np.argsort(-shares) if shares[label] >= 0.01]
    legend = label_legend(photo.shape[1], segmenter.labels, np.flatnonzero(shares).tolist())
    text = ", ".join(f"{segmenter.labels.name_of(label)} {shares[label]:.0%}" for label in seen)
    return f"{text}, {spent}", with_legend(overlay_labels(photo, labels, segmenter.labels), legend)


def _trial_scene() -> UInt8Array:
    """Return a drawn scene (360, 640, 3) of rough sky, far land and near land, for tests without a photo."""
    rough = cv2.resize(np.random.default_rng(5).normal(0.0, 14.0, (120, 213)), (640, 360))
    row = np.searchsorted((120, 210), np.arange(360))
    colors = np.array([(140, 180, 220), (105, 120, 130), (70, 85, 45)])[row][:, None]
    return np.asarray(np.clip(colors + rough[..., None], 0, 255), np.uint8)
