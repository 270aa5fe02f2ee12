"""Draws a network's labels beside the true labels over the photo, as PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

import numpy as np

from ltm_core.base.types import UInt8Array
from ltm_core.pictures.drawing import to_png
from ltm_core.pictures.legend import label_legend, with_legend
from ltm_core.pictures.photo_overlays import overlay_labels
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.segmenter import Segmentation


class LabelledPhoto(Protocol):
    """A photo (H, W, 3) uint8 RGB and the true class of each pixel (H, W) uint8, 255 unknown."""

    @property
    def image(self) -> UInt8Array: ...
    @property
    def labels(self) -> UInt8Array: ...


class StoredPhoto(LabelledPhoto, Protocol):
    """A labelled photo with the path of its file."""

    @property
    def path(self) -> Path: ...


def write_overlay(folder: Path, network: str, labels: LabelSet, frame: StoredPhoto, found: Segmentation) -> None:
    """Write `<folder>/<set>_<frame>_<network>.png`: true labels on the left, the network's on the right."""
    drawn = [overlay_labels(frame.image, each, labels) for each in (frame.labels, found.labels)]
    sheet = np.concatenate(drawn, axis=1)
    sheet = with_legend(sheet, label_legend(sheet.shape[1], labels))
    folder.mkdir(parents=True, exist_ok=True)
    path = frame.path
    name = f"{path.parent.resolve().name}_{path.stem}_{network.replace(' ', '_')}.png"
    (folder / name).write_bytes(to_png(sheet))
