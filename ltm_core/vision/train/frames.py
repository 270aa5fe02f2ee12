"""Rendered frames with their labels, split by scenario."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from ltm_core.errors import ImageError, RecordingError
from ltm_core.vision.labels import UNLABELLED
from ltm_core.vision.train.config import SplitConfig

LABELS_SUFFIX = "_labels.png"


@dataclass(frozen=True)
class Frame:
    """A photo (H, W, 3) uint8 RGB and the class of each pixel (H, W) uint8, 255 unknown."""

    image: npt.NDArray[np.uint8]
    labels: npt.NDArray[np.uint8]
    path: Path


@dataclass(frozen=True)
class Split:
    """Frames to train on, to choose the weights by, and to score at the end; no scenario is in two of them."""

    train: list[Frame]
    validation: list[Frame]
    test: list[Frame]


def read_frames(folder: Path, classes: int, sampled: bool = False) -> list[Frame]:
    """Frames `NNNN.png` of a folder that have their `NNNN_labels.png`, in order of name.

    With `sampled`, labels may also be those of every n-th pixel (`full[::n, ::n]`); the pixels between are then 255:
    enough to score, not to train. Raises RecordingError where there is no frame; ImageError where a picture cannot be
    read, its labels have another size, or hold an id that is neither below `classes` nor 255.
    """
    pairs = [
        (path.with_name(path.name.removesuffix(LABELS_SUFFIX) + ".png"), path)
        for path in sorted(folder.glob(f"*{LABELS_SUFFIX}"))
    ]
    frames = [_read(photo, labels, classes, sampled) for photo, labels in pairs if photo.is_file()]
    if not frames:
        raise RecordingError(f"{folder}: no frames; expected pictures NNNN.png with NNNN{LABELS_SUFFIX} beside them")
    return frames


def _read(photo: Path, truth: Path, classes: int, sampled: bool) -> Frame:
    image = cv2.imread(str(photo), cv2.IMREAD_COLOR)
    labels = cv2.imread(str(truth), cv2.IMREAD_UNCHANGED)
    if image is None or labels is None:
        raise ImageError(f"{photo if image is None else truth}: cannot be read as a picture; render the frame again")
    if sampled:
        labels = _spread(labels, image.shape[0], image.shape[1])
    if labels.shape != image.shape[:2] or labels.dtype != np.uint8:
        raise ImageError(f"{truth}: is {labels.shape} {labels.dtype}, expected {image.shape[:2]} uint8 like its photo")
    ids = np.unique(labels)
    wrong = ids[(ids >= classes) & (ids != UNLABELLED)]
    if wrong.size:
        raise ImageError(f"{truth}: holds label {wrong[0]}, expected ids below {classes} or {UNLABELLED}")
    return Frame(np.ascontiguousarray(image[..., ::-1], dtype=np.uint8), np.asarray(labels, np.uint8), photo)


def _spread(labels: npt.NDArray[np.uint8], height: int, width: int) -> npt.NDArray[np.uint8]:
    """Labels of every n-th pixel put at their places in a full image; any other shape is left as it is."""
    step = -(-height // labels.shape[0])
    full = np.full((height, width), UNLABELLED, np.uint8)
    if full[::step, ::step].shape != labels.shape or step == 1:
        return labels
    full[::step, ::step] = labels
    return full


def read_split(folder: Path, split: SplitConfig, classes: int) -> Split:
    """Every scenario below `folder`, read and split. Raises RecordingError for a held-out scenario that is absent."""
    scenarios = {path.name: path for path in sorted(folder.iterdir()) if path.is_dir()} if folder.is_dir() else {}
    absent = sorted({*split.validation, *split.test} - set(scenarios))
    if absent:
        raise RecordingError(
            f"{folder}: no scenario {', '.join(absent)}, held out by the configuration; "
            f"scenarios there: {', '.join(scenarios) or 'none'}"
        )
    held_out = {*split.validation, *split.test}
    return Split(
        train=[f for name, path in scenarios.items() if name not in held_out for f in read_frames(path, classes)],
        validation=[f for name in split.validation for f in read_frames(scenarios[name], classes, sampled=True)],
        test=[f for name in split.test for f in read_frames(scenarios[name], classes, sampled=True)],
    )
