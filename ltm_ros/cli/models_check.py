"""Run a network on trial for `ltm models check`."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console

from ltm_core.base.errors import ImageError
from ltm_core.base.types import UInt8Array
from ltm_core.depth.monocular import DepthNetwork, NetworkDepth
from ltm_core.geometry.camera import Camera
from ltm_core.pictures import label_legend, overlay_labels, to_jpeg, with_legend
from ltm_core.storage.text_io import check_picture, photos_in
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.overlays import scene_of
from ltm_core.vision.segmenter import Segmenter
from ltm_core.vision.vocabulary import open_vocabulary, parse_queries


def check(
    console: Console,
    manifest: NetworkManifest,
    threads: int,
    images: Path | None,
    out: Path,
    *,
    classes: str | None = None,
    zoom: float = 1.0,
) -> None:
    """Print the model's input, output and running time; write overlay images.

    With `classes`, comma-separated words replace the model's classes. Without `images`, a drawn scene is used.
    """
    if classes is None:
        segmenter = Segmenter(manifest, threads)
    else:
        segmenter, readings = open_vocabulary(manifest, parse_queries(classes), threads)
        for reading in readings:
            console.print(f"{reading.query!r} {reading.how}", markup=False)
    _describe(console, manifest, segmenter.model_path)
    noise = np.random.default_rng(0).integers(0, 256, (1080, 1920, 3), dtype=np.uint8)
    times = _milliseconds(segmenter, noise, repeats=15)
    console.print(
        f"1920 x 1080, {threads} thread(s): median {np.median(times):.1f} ms, p95 {np.percentile(times, 95):.1f} ms"
    )
    if images is None:
        _overlay(console, segmenter, trial_scene(), Path("trial_scene"), out, zoom)
    for path in photos_in(images) if images is not None else []:
        _overlay(console, segmenter, _read(path), path, out, zoom)


def check_depth(console: Console, manifest: NetworkManifest, threads: int, images: Path | None, out: Path) -> None:
    """Print the input, output and running time of a depth model; write images (red near, blue far)."""
    network = DepthNetwork(manifest, threads)
    _describe(console, manifest, manifest.model_file())
    pictures = [(path, _read(path)) for path in photos_in(images)] if images is not None else []
    for path, photo in pictures or [(Path("trial_scene"), trial_scene())]:
        camera = Camera.from_fov(photo.shape[1], photo.shape[0], 50.0)
        network.predict(photo, camera)
        start = time.perf_counter()
        found = network.predict(photo, camera)
        milliseconds = (time.perf_counter() - start) * 1e3
        target = out / f"{path.stem}_{manifest.name}.jpg"
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(to_jpeg(np.vstack([photo, _depth_colors(found, photo.shape[:2])])))
        spread = f"{np.nanmin(found.values):.4g}..{np.nanmax(found.values):.4g}"
        console.print(f"{path.name}: {found.kind} {spread}, {milliseconds:.0f} ms -> {target}")


def trial_scene() -> UInt8Array:
    """Return a drawn scene (360, 640, 3) with sky, two ridges and a meadow, for tests without a photo."""
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


def _milliseconds(segmenter: Segmenter, image: UInt8Array, repeats: int) -> list[float]:
    """Return the wall time of each call of `segment`, after one call that is not counted."""
    segmenter.segment(image)
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        segmenter.segment(image)
        times.append((time.perf_counter() - start) * 1e3)
    return times


def _describe(console: Console, manifest: NetworkManifest, path: Path) -> None:
    spec = manifest.input
    console.print(f"{manifest.name}: {path}; sha256 {manifest.sha256[:12]}... and shapes are as its manifest states")
    console.print(f"input {spec.layout} {spec.dtype} {spec.shape}; output {manifest.output.kind}", markup=False)


def _depth_colors(found: NetworkDepth, size: tuple[int, ...]) -> UInt8Array:
    """Return the ranks of a depth image as colours."""
    values = found.values if found.kind == "relative_inverse" else -found.values
    ranks = np.searchsorted(np.sort(values[np.isfinite(values)]), values) / values.size * 255.0
    large = cv2.resize(np.nan_to_num(ranks).astype(np.uint8), size[::-1], interpolation=cv2.INTER_LINEAR)
    return np.ascontiguousarray(cv2.applyColorMap(np.asarray(large, np.uint8), cv2.COLORMAP_TURBO)[..., ::-1])


def _overlay(console: Console, segmenter: Segmenter, photo: UInt8Array, path: Path, out: Path, zoom: float) -> None:
    labels = segmenter.segment(photo, zoom).labels
    shares = np.bincount(labels.ravel(), minlength=256) / labels.size
    seen = [int(label) for label in np.argsort(-shares) if shares[label] >= 0.01]
    legend = label_legend(photo.shape[1], segmenter.labels, seen)
    target = out / f"{path.stem}_{segmenter.manifest.name}.jpg"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(to_jpeg(with_legend(overlay_labels(photo, labels, segmenter.labels), legend)))
    text = ", ".join(f"{segmenter.labels.name_of(label)} {shares[label]:.0%}" for label in seen)
    console.print(f"{path.name} ({photo.shape[1]} x {photo.shape[0]}): {text} -> {target}")


def _read(path: Path) -> UInt8Array:
    check_picture(path)
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise ImageError(f"{path}: cannot be read as an image")
    return scene_of(np.ascontiguousarray(image[..., ::-1], dtype=np.uint8))
