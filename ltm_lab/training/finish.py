"""Finishes a trained network: export, calibration of its confidence, measurement of its confusion matrix."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from scipy import optimize

from ltm_core.base.errors import ImageError
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.fuel.label_errors import ReliabilityRecord, labels_digest, shares_of, write_record
from ltm_core.label_heads.head_fit import balanced
from ltm_core.label_heads.labelled_frames import Frame
from ltm_core.scoring.labels import CalibrationScore, SegmentationScore
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.manifest import NetworkManifest
from ltm_core.vision.segmenter import Segmenter

_PIXELS = 4000  # of a frame, drawn for the temperature
_RANGE = (0.2, 8.0)  # of temperatures; at either end something other than the temperature is wrong


class SetScore(NamedTuple):
    """Scores of one set of frames: classes, and whether confidence means something."""

    labels: SegmentationScore
    calibration: CalibrationScore


def calibrate(
    manifest: Path, frames: Sequence[Frame], labels: LabelSet, seed: int
) -> tuple[float, dict[str, SetScore]]:
    """Fit the temperature on frames that did not train the network, write it into the manifest, and the confusion
    matrix of these frames beside it; gives the temperature and the scores of each set.

    Sets count alike, so a hundred rendered frames do not outvote twenty photos.
    """
    segmenter = Segmenter.open(manifest, labels=labels)
    rng = np.random.default_rng(seed)
    sets: dict[str, list[Frame]] = {}
    for frame in frames:
        sets.setdefault(frame.path.parent.name, []).append(frame)
    logits, truth = [], []
    for members in sets.values():
        for frame in members:
            found = _pixels(segmenter, frame, max(1, _PIXELS * 10 // len(members)), rng)
            logits.append(found[0])
            truth.append(found[1])
    temperature = fit_temperature(np.concatenate(logits), np.concatenate(truth))
    content = yaml.safe_load(manifest.read_text(encoding="utf-8"))
    content["output"]["temperature"] = round(temperature, 4)
    manifest.write_text(yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110), encoding="utf-8")
    scores = score_sets(Segmenter.open(manifest, labels=labels), frames)
    confusion = balanced([score.labels.confusion for score in scores.values()])
    network = NetworkManifest.load(manifest)
    record = ReliabilityRecord(
        source="labels on " + ", ".join(f"{name} ({len(members)} frames)" for name, members in sets.items()),
        network=network.name,
        labels=labels_digest(network),
        photos=sum(not frame.rendered for members in sets.values() for frame in members),
        ece={name: round(score.calibration.ece, 4) for name, score in scores.items()},
        shares=shares_of(labels.names, confusion),
    )
    write_record(record, manifest.parent)
    return temperature, scores


def fit_temperature(logits: Float32Array, labels: UInt8Array) -> float:
    """Return the temperature T for which softmax(logits / T) explains the labels best (Guo et al. 2017).

    `logits` (N, K) of pixels whose true label (N,) is known, below K. Raises ImageError where there are none.
    """
    if len(logits) == 0 or logits.shape[0] != labels.shape[0]:
        raise ImageError(f"logits {logits.shape} and labels {labels.shape}: expected (N, K) and (N,), N > 0")
    scores = np.asarray(logits, np.float64)
    rows = np.arange(len(scores))

    def cost(log_temperature: float) -> float:
        scaled = scores * np.exp(-log_temperature)
        top = scaled.max(axis=1)
        normaliser = top + np.log(np.exp(scaled - top[:, None]).sum(axis=1))
        return float((normaliser - scaled[rows, labels]).mean())

    bounds = (float(np.log(_RANGE[0])), float(np.log(_RANGE[1])))
    return float(np.exp(optimize.minimize_scalar(cost, bounds=bounds, method="bounded").x))


def score_sets(segmenter: Segmenter, frames: Sequence[Frame]) -> dict[str, SetScore]:
    """Scores of a segmenter on each set (folder) of frames."""
    classes = len(segmenter.labels)
    scores: dict[str, SetScore] = {}
    for frame in frames:
        found = segmenter.segment(frame.image)
        name = frame.path.parent.name
        labels, calibration = scores.get(name, SetScore(SegmentationScore.empty(classes), CalibrationScore.empty()))
        scores[name] = SetScore(
            labels.plus(frame.labels, found.labels),
            calibration.plus(frame.labels, found.labels, found.confidence, classes),
        )
    return scores


def _pixels(
    segmenter: Segmenter, frame: Frame, count: int, rng: np.random.Generator
) -> tuple[Float32Array, UInt8Array]:
    """Logits (N, K) and true labels (N,) of random labelled pixels, each at the nearest place of the network's grid."""
    logits = segmenter.logits(frame.image)
    rows, cols = np.nonzero(frame.labels < len(segmenter.labels))
    chosen = rng.integers(0, len(rows), min(count, len(rows))) if len(rows) else np.empty(0, np.int64)
    rows, cols = rows[chosen], cols[chosen]
    height, width = frame.labels.shape
    places = rows * logits.shape[1] // height, cols * logits.shape[2] // width
    return logits[:, places[0], places[1]].T, frame.labels[rows, cols]
