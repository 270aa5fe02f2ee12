"""Draws a network's answer beside the truth over the photo, as PNG."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ltm_core.pictures.encode import to_png
from ltm_core.pictures.legend import label_legend, with_legend
from ltm_core.pictures.overlay import overlay_labels
from ltm_core.training.labelled_frames import Frame
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.segmenter import Segmentation


def write_overlay(folder: Path, network: str, labels: LabelSet, frame: Frame, found: Segmentation) -> None:
    """`<folder>/<set>_<frame>_<network>.png`: truth at the left, the answer at the right, both at the photo's size."""
    answer, truth = (overlay_labels(frame.image, ids, labels) for ids in (found.labels, frame.labels))
    sheet = np.concatenate([truth, answer], axis=1)
    sheet = with_legend(sheet, label_legend(sheet.shape[1], labels))
    name = f"{frame.path.parent.resolve().name}_{frame.path.stem}_{network.replace(' ', '_')}.png"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / name).write_bytes(to_png(sheet))
