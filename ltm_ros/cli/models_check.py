"""The trial runs behind `ltm models check`."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from ltm_core.errors import ImageError
from ltm_core.metrics.segmentation import score_labels
from ltm_core.pictures import label_legend, overlay_labels, to_jpeg, with_legend
from ltm_core.vision.evaluate import score_segmenter, segment_milliseconds
from ltm_core.vision.labels import Label
from ltm_core.vision.segmenter import Segmenter
from ltm_core.vision.train.frames import read_frames
from ltm_ros.cli.score_table import score_table

_PHOTOS = {".jpg", ".jpeg", ".png"}


def check(
    console: Console,
    segmenter: Segmenter,
    images: Path | None,
    frames: Path | None,
    sky_masks: Path | None,
    out: Path,
) -> None:
    """Print what the model takes and gives, its time, and scores where there is truth; write overlay pictures."""
    manifest, spec = segmenter.manifest, segmenter.manifest.input
    console.print(f"{manifest.name}: {segmenter.model_path}; checksum and shapes are as its manifest states")
    console.print(f"input {spec.layout} {spec.dtype} {spec.shape}; output {manifest.output.kind}", markup=False)
    noise = np.random.default_rng(0).integers(0, 256, (1080, 1920, 3), dtype=np.uint8)
    times = segment_milliseconds(segmenter, [noise], repeats=15)
    console.print(f"1920 x 1080: median {np.median(times):.1f} ms, p95 {np.percentile(times, 95):.1f} ms")
    photos = _photos(images) if images is not None else []
    for path in photos:
        _overlay(console, segmenter, path, out)
    if photos and sky_masks is not None:
        _score_sky(console, segmenter, photos, sky_masks)
    if frames is not None:
        pairs = [(frame.image, frame.labels) for frame in read_frames(frames, len(segmenter.labels), sampled=True)]
        score = score_segmenter(segmenter, pairs)
        console.print(score_table(segmenter.labels.names, score, f"{manifest.name} on {frames}"))


def _overlay(console: Console, segmenter: Segmenter, path: Path, out: Path) -> None:
    photo = _read(path)
    labels = segmenter.segment(photo).labels
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


def _photos(images: Path) -> list[Path]:
    paths = [images] if images.is_file() else sorted(images.glob("*"))
    photos = [path for path in paths if path.suffix.lower() in _PHOTOS and not path.stem.endswith("_labels")]
    if not photos:
        raise ImageError(f"{images}: no photos; expected files ending in {', '.join(sorted(_PHOTOS))}")
    return photos


def _read(path: Path) -> NDArray[np.uint8]:
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        raise ImageError(f"{path}: cannot be read as a picture")
    return np.ascontiguousarray(image[..., ::-1], dtype=np.uint8)
