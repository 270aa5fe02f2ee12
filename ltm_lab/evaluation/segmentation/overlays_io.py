"""Draws a network's answer beside the truth over the photo, or beside the photo alone, as PNG."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ltm_core.base.types import UInt8Array
from ltm_core.pictures.drawing import to_png
from ltm_core.pictures.legend import label_legend, with_legend
from ltm_core.pictures.photo_overlays import overlay_labels
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.segmenter import Segmentation
from ltm_lab.training.labelled_frames import Frame


def write_overlay(folder: Path, network: str, labels: LabelSet, frame: Frame, found: Segmentation) -> None:
    """`<folder>/<set>_<frame>_<network>.png`: truth at the left, the answer at the right, both at the photo's size."""
    _write(folder, network, labels, frame.path, overlay_labels(frame.image, frame.labels, labels), frame.image, found)


def write_answer(
    folder: Path, network: str, labels: LabelSet, path: Path, photo: UInt8Array, found: Segmentation
) -> None:
    """As `write_overlay`, of a photo (H, W, 3) of which no truth is known: the photo itself is at the left."""
    _write(folder, network, labels, path, photo, photo, found)


def _write(
    folder: Path,
    network: str,
    labels: LabelSet,
    path: Path,
    left: UInt8Array,
    photo: UInt8Array,
    found: Segmentation,
) -> None:
    sheet = np.concatenate([left, overlay_labels(photo, found.labels, labels)], axis=1)
    sheet = with_legend(sheet, label_legend(sheet.shape[1], labels))
    folder.mkdir(parents=True, exist_ok=True)
    name = f"{path.parent.resolve().name}_{path.stem}_{network.replace(' ', '_')}.png"
    (folder / name).write_bytes(to_png(sheet))
