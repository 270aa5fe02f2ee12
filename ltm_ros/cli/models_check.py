"""Trial runs of a network for `ltm models check`."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console

from ltm_core.camera import Camera
from ltm_core.depth.monocular import DepthNetwork, NetworkDepth
from ltm_core.errors import ImageError
from ltm_core.evaluation.metrics.segmentation import score_labels
from ltm_core.evaluation.segmentation.network_score import score_segmenter, segment_milliseconds
from ltm_core.picture_io import check_picture, photos_in
from ltm_core.pictures import label_legend, overlay_labels, to_jpeg, with_legend
from ltm_core.training.labelled_frames import read_frames
from ltm_core.types import UInt8Array
from ltm_core.vision.labels import Label
from ltm_core.vision.manifest import Manifest
from ltm_core.vision.segmenter import Segmenter
from ltm_core.vision.vocabulary import open_vocabulary, parse_queries
from ltm_ros.cli.eval.score_table import score_table


def check(
    console: Console,
    manifest: Manifest,
    threads: int,
    images: Path | None,
    frames: Path | None,
    sky_masks: Path | None,
    out: Path,
    *,
    classes: str | None = None,
    zoom: float = 1.0,
) -> None:
    """Print what the model takes and gives, its time, and scores where there is truth; write overlay pictures.

    With `classes`, comma-separated words are looked for instead of the model's own classes. Without `images` the
    picture is of a plain scene that is drawn here.
    """
    if classes is None:
        segmenter = Segmenter(manifest, threads)
    else:
        segmenter, readings = open_vocabulary(manifest, parse_queries(classes), threads)
        for reading in readings:
            console.print(f"{reading.query!r} {reading.how}", markup=False)
    _describe(console, manifest, segmenter.model_path)
    noise = np.random.default_rng(0).integers(0, 256, (1080, 1920, 3), dtype=np.uint8)
    times = segment_milliseconds(segmenter, [noise], repeats=15)
    console.print(
        f"1920 x 1080, {threads} thread(s): median {np.median(times):.1f} ms, p95 {np.percentile(times, 95):.1f} ms"
    )
    if images is None:
        _overlay(console, segmenter, trial_scene(), Path("trial_scene"), out, zoom)
    photos = photos_in(images) if images is not None else []
    for path in photos:
        _overlay(console, segmenter, _read(path), path, out, zoom)
    if photos and sky_masks is not None:
        _score_sky(console, segmenter, photos, sky_masks)
    if frames is not None:
        pairs = [(frame.image, frame.labels) for frame in read_frames(frames, len(segmenter.labels), sampled=True)]
        score = score_segmenter(segmenter, pairs)
        console.print(score_table(segmenter.labels.names, score, f"{manifest.name} on {frames}"))


def check_depth(console: Console, manifest: Manifest, threads: int, images: Path | None, out: Path) -> None:
    """Print what a depth model takes and gives and its time; write pictures, near red and far blue."""
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
    """A sky over two ridges and a meadow, (360, 640, 3): enough for a trial where no photo is at hand."""
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


def _describe(console: Console, manifest: Manifest, path: Path) -> None:
    spec = manifest.input
    console.print(f"{manifest.name}: {path}; sha256 {manifest.sha256[:12]}... and shapes are as its manifest states")
    console.print(f"input {spec.layout} {spec.dtype} {spec.shape}; output {manifest.output.kind}", markup=False)


def _depth_colors(found: NetworkDepth, size: tuple[int, ...]) -> UInt8Array:
    """Ranks of a depth image as colours: a network's own scale means nothing to the eye."""
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


def _score_sky(console: Console, segmenter: Segmenter, photos: list[Path], masks: Path) -> None:
    """IoU of the sky with masks named `<photo>_mask.*` (white: ground), `_resized` in the photo's name left out."""
    scores = []
    for path in photos:
        stem = path.stem.removesuffix("_resized")
        found = sorted(masks.glob(f"{stem}_mask.*"))
        if not found:
            raise ImageError(f"{masks}: no mask for {path.name}; expected {stem}_mask.png or .jpg")
        sky = (_read(found[0])[..., 0] < 128).astype(np.uint8)
        predicted = (segmenter.segment(_read(path)).labels == Label.SKY).astype(np.uint8)
        scores.append(float(score_labels(sky, predicted, 2).iou[1]))
        console.print(f"{path.name}: sky IoU {scores[-1]:.3f}")
    console.print(f"sky IoU over {len(scores)} photos: mean {np.mean(scores):.3f}, least {np.min(scores):.3f}")


def _read(path: Path) -> UInt8Array:
    check_picture(path)
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise ImageError(f"{path}: cannot be read as a picture")
    return np.ascontiguousarray(image[..., ::-1], dtype=np.uint8)
