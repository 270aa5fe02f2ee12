"""Scores label networks on labelled frames."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.label_heads.labelled_frames import Frame
from ltm_core.pictures.legend import label_legend, to_png, with_legend
from ltm_core.pictures.photo_overlays import overlay_labels
from ltm_core.scoring.labels import CalibrationScore, SegmentationScore
from ltm_core.vision.labels import UNLABELLED, Label, LabelSet
from ltm_core.vision.segmenter import Segmentation, Segmenter
from ltm_lab.evaluation.metrics.skyline import SkylineScore, SkylineTally, skyline

_LAND_AND_SKY = (Label.SKY, Label.GRASS, Label.SHRUB, Label.TREE, Label.BARE)
_SKYLINE_WIDTH = 512  # pixels, to which skyline errors are brought


@dataclass(frozen=True)
class LabelScore:
    """Scores of one segmenter on one set of frames. Skyline errors are in pixels of a photo 512 wide. Calibration and
    risk are of all pixels, and of those that are not sky in truth: sky is most of a tower's photo, and easy."""

    labels: SegmentationScore
    calibration: CalibrationScore
    land_calibration: CalibrationScore
    skyline: SkylineScore
    milliseconds: float
    macro: tuple[int, ...] = _LAND_AND_SKY

    @property
    def macro_f1(self) -> float:
        """Mean F1 of the classes `macro`, of those that occur."""
        return self.labels.macro_f1(self.macro)

    @property
    def shrub_as_tree(self) -> float:
        """Share of true shrub that is called tree; NaN where no shrub is."""
        shrub = self.labels.confusion[Label.SHRUB]
        return float(shrub[Label.TREE] / shrub.sum()) if shrub.sum() else float("nan")

    @property
    def sky_iou(self) -> float:
        return float(self.labels.iou[Label.SKY])

    def summary(self, names: tuple[str, ...]) -> dict[str, Any]:
        """All figures, JSON-ready; None for what does not occur."""
        score = self.labels

        def by_class(values: Float64Array) -> dict[str, float | None]:
            return {name: _known(float(values[k])) for k, name in enumerate(names)}

        return {
            "pixels": score.pixels,
            "f1": by_class(score.f1),
            "iou": by_class(score.iou),
            "macro_f1": _known(self.macro_f1),
            "macro_f1_of": [names[k] for k in self.macro],
            "shrub_called_tree": _known(self.shrub_as_tree),
            "sky_iou": _known(self.sky_iou),
            "skyline_median_px": _known(self.skyline.median),
            "skyline_p95_px": _known(self.skyline.p95),
            "skyline_columns": self.skyline.columns,
            "skyline_missed": self.skyline.missed,
            "accuracy": _known(score.accuracy),
            "unlabelled": _known(score.unlabelled),
            "ece": _known(self.calibration.ece),
            "risk": _known(self.calibration.risk()),
            "risk_at_80": _known(self.calibration.risk(0.8)),
            "land": {
                "ece": _known(self.land_calibration.ece),
                "risk": _known(self.land_calibration.risk()),
                "risk_at_80": _known(self.land_calibration.risk(0.8)),
            },
            "milliseconds": self.milliseconds,
            "confusion": score.confusion.tolist(),
        }


def score_frames(
    segmenter: Segmenter,
    frames: Sequence[Frame],
    macro: tuple[int, ...] = _LAND_AND_SKY,
    look: Callable[[Frame, Segmentation], None] = lambda frame, found: None,
) -> LabelScore:
    """Label each frame and compare with its truth, where that is known. `macro`: classes of the mean F1; `look` gets
    each answer, to draw it."""
    classes = len(segmenter.labels)
    labels, calibration, tally = SegmentationScore.empty(classes), CalibrationScore.empty(), SkylineTally()
    land_calibration = CalibrationScore.empty()
    times = []
    for frame in frames:
        start = time.perf_counter()
        found = segmenter.segment(frame.image)
        times.append((time.perf_counter() - start) * 1e3)
        labels = labels.plus(frame.labels, found.labels)
        calibration = calibration.plus(frame.labels, found.labels, found.confidence, classes)
        land = np.where(frame.labels == Label.SKY, np.uint8(UNLABELLED), frame.labels)
        land_calibration = land_calibration.plus(land, found.labels, found.confidence, classes)
        look(frame, found)
        scale, step = np.float32(_SKYLINE_WIDTH / frame.labels.shape[1]), _truth_step(frame.labels)
        sampled = frame.labels[::step, ::step]
        # Where truth's sky ends at a pixel of which nothing is known, its skyline may lie lower: not compared.
        truth = skyline(sampled == Label.SKY, sampled >= classes)
        half = np.float32((step - 1) / 2)  # the tally's own offset, which must not be scaled
        tally.add(scale * (skyline(found.labels == Label.SKY) + half) - half, scale * truth, step)
    milliseconds = float(np.median(times))
    return LabelScore(labels, calibration, land_calibration, tally.score(), milliseconds, macro)


def _truth_step(labels: UInt8Array) -> int:
    """Rows between those that hold truth: 1, or n where only every n-th pixel is labelled."""
    rows = np.flatnonzero((labels != UNLABELLED).any(axis=1))
    return int(np.diff(rows).min()) if len(rows) > 1 else 1


def _known(value: float) -> float | None:
    return value if np.isfinite(value) else None


def write_overlay(folder: Path, network: str, labels: LabelSet, frame: Frame, found: Segmentation) -> None:
    """Write `<folder>/<set>_<frame>_<network>.png`: true labels on the left, the network's on the right."""
    drawn = [overlay_labels(frame.image, each, labels) for each in (frame.labels, found.labels)]
    sheet = np.concatenate(drawn, axis=1)
    sheet = with_legend(sheet, label_legend(sheet.shape[1], labels))
    folder.mkdir(parents=True, exist_ok=True)
    path = frame.path
    name = f"{path.parent.resolve().name}_{path.stem}_{network.replace(' ', '_')}.png"
    (folder / name).write_bytes(to_png(sheet))
