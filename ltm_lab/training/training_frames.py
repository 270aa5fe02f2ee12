"""Reads frames with labels and inverse depth, or a teacher's order of depth, to train or to score a network.

Beside the files of `labelled_frames`, a simulated set has `frames.json` and `NAME_truth.npz`, whose ranges give the
true depth. Photos may have `NAME_order.npz` with `inverse` (h, w), a teacher's inverse depth of which only the order is
trusted; posed frames `NAME_depth.npz` with `depth` (h, w), metres along the optical axis. `NAME_absent.txt` is a
statement about the whole photo (see `statements`).
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.label_heads.labelled_frames import INDEX_FILE, UNKNOWN, Frame, read_frames
from ltm_lab.training.config import SplitConfig
from ltm_lab.training.statements import rows_of

STATEMENT_SUFFIX = "_absent.txt"


@dataclass(frozen=True)
class TrainingFrame(Frame):
    """A frame with its inverse depth.

    `inverse` (H, W) float32: 1 / metres along the optical axis, NaN where unknown or sky; None if unknown everywhere.
    `ordinal`: `inverse` tells only which of two pixels is nearer.
    """

    inverse: Float32Array | None = field(default=None, repr=False)
    ordinal: bool = False


@dataclass(frozen=True)
class Split:
    """Frames to train on, to choose the weights by, and to score at the end; no set is in two of them."""

    train: list[TrainingFrame]
    validation: list[TrainingFrame]
    test: list[TrainingFrame]


def read_training_frames(folder: Path, classes: int, sampled: bool = False) -> list[TrainingFrame]:
    """Read the frames of a folder with what is known of their depth. Raises as `read_frames` does."""
    cameras, frames = _cameras(folder), []
    for frame in read_frames(folder, classes, sampled):
        inverse, ordinal = _inverse_depth(frame.path, cameras.get(frame.path.stem), frame.labels.shape[:2])
        frames.append(TrainingFrame(frame.image, _with_statement(frame), frame.path, inverse, ordinal))
    return frames


def read_split(folder: Path, split: SplitConfig, classes: int) -> Split:
    """Every set below `folder`, read and split. Raises RecordingError for a held-out set that is absent."""
    sets = {path.name: path for path in sorted(folder.iterdir()) if path.is_dir()} if folder.is_dir() else {}
    absent = sorted({*split.validation, *split.test} - set(sets))
    if absent:
        raise RecordingError(
            f"{folder}: no scenario {', '.join(absent)}, held out by the configuration; "
            f"scenarios there: {', '.join(sets) or 'none'}"
        )
    held_out = {*split.validation, *split.test}
    return Split(
        train=[f for name, path in sets.items() if name not in held_out for f in read_training_frames(path, classes)],
        validation=[f for name in split.validation for f in read_training_frames(sets[name], classes, sampled=True)],
        test=[f for name in split.test for f in read_training_frames(sets[name], classes, sampled=True)],
    )


def _cameras(folder: Path) -> dict[str, Camera]:
    index = folder / INDEX_FILE
    if not index.is_file():
        return {}
    entries = json.loads(index.read_text(encoding="utf-8"))["frames"]
    return {Path(entry["image"]).stem: _camera(entry["truth_camera"]) for entry in entries}


def _camera(values: dict[str, Any]) -> Camera:
    return Camera(**{**values, "distortion": tuple(values["distortion"])})


def _inverse_depth(photo: Path, camera: Camera | None, size: tuple[int, int]) -> tuple[Float32Array | None, bool]:
    """What the files beside a photo say of its depth, at the photo's size, and whether it is an order only."""
    base = photo.with_suffix("")
    truth, depth, order = (base.with_name(f"{base.name}_{kind}.npz") for kind in ("truth", "depth", "order"))
    if truth.is_file() and camera is not None:
        with np.load(truth) as content:
            ranges = content["range_surface"]
        if ranges.shape == (camera.height, camera.width):
            return _at_size(_inverse(ranges * camera.rays()[..., 2]), size), False
    if depth.is_file():
        with np.load(depth) as content:
            return _at_size(_inverse(content["depth"]), size), False
    if order.is_file():
        with np.load(order) as content:
            return _at_size(content["inverse"].astype(np.float32), size), True
    return None, False


def _with_statement(frame: Frame) -> UInt8Array:
    """The labels of a frame, with what the file beside it says of the whole photo where nothing else is known."""
    said = frame.path.with_name(f"{frame.path.stem}{STATEMENT_SUFFIX}")
    if not said.is_file():
        return frame.labels
    rows = rows_of(said.read_text(encoding="utf-8"), frame.labels.shape[0])
    return np.where(frame.labels == UNKNOWN, rows[:, None], frame.labels)


def _inverse(depth: npt.NDArray[Any]) -> Float32Array:
    known = np.isfinite(depth) & (depth > 0)
    return np.asarray(np.divide(1.0, depth, out=np.full(depth.shape, np.nan), where=known), np.float32)


def _at_size(inverse: Float32Array, size: tuple[int, int]) -> Float32Array:
    if inverse.shape == size:
        return inverse
    return np.asarray(cv2.resize(inverse, size[::-1], interpolation=cv2.INTER_NEAREST), np.float32)
