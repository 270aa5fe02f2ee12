"""Reads frames with their labels, inverse depth, or a teacher's relative depth, for training and scoring.

A set is a folder of pictures `NAME.png` or `NAME.jpg`, each with `NAME_labels.png` (uint8 ids), or with areas that a
person named in the folder's `polygons.json` (`polygon_labels_io`); of both, the PNG is taken. A simulated set
has `frames.json` and `NAME_truth.npz` too, whose ranges give the true depth; photos may have `NAME_order.npz` with
`inverse` (h, w), a teacher's inverse depth that is trusted for its order alone; posed frames `NAME_depth.npz` with
`depth` (h, w), metres along the optical axis.
"""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import numpy.typing as npt

from ltm_core.base.errors import ImageError, RecordingError
from ltm_core.base.types import Float32Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.storage.photo_io import check_picture
from ltm_core.vision.areas import POLYGONS_FILE, NamedArea, labels_of
from ltm_core.vision.labels import UNLABELLED, LabelSet
from ltm_lab.training.config import SplitConfig
from ltm_lab.training.polygon_labels_io import read_polygons

LABELS_SUFFIX = "_labels.png"
_INDEX: Final = "frames.json"
UNKNOWN: Final = 254
"""In labels to train on: nothing at all is known of the pixel (255: it is no sky)."""
LAND: Final = 253
"""In labels to train on: a slope of unknown cover, so neither sky nor water nor built."""


@dataclass(frozen=True)
class Frame:
    """A photo (H, W, 3) uint8 RGB, the class of each pixel (H, W) uint8 (255 unlabelled), and its inverse depth.

    `inverse` (H, W) float32: 1 / metres along the optical axis, NaN where unknown or sky; with `ordinal` its values
    tell near from far and nothing more. None where nothing is known of any pixel.
    """

    image: UInt8Array
    labels: UInt8Array
    path: Path
    inverse: Float32Array | None = field(default=None, repr=False)
    ordinal: bool = False

    @property
    def rendered(self) -> bool:
        """Whether it is of a simulated set."""
        return (self.path.parent / _INDEX).is_file()


@dataclass(frozen=True)
class Split:
    """Frames to train on, to choose the weights by, and to score at the end; no set is in two of them."""

    train: list[Frame]
    validation: list[Frame]
    test: list[Frame]


def read_frames(folder: Path, classes: int, sampled: bool = False) -> list[Frame]:
    """Frames of a folder that have their labels, in order of name.

    With `sampled`, labels may also be those of every n-th pixel (`full[::n, ::n]`); the pixels between are then 255:
    enough to score, not to train. Raises RecordingError where there is no frame, or no such list of areas; ImageError
    where a picture cannot be read, its labels have another size, or hold an id that is none of `classes`, LAND, UNKNOWN
    and 255.
    """
    cameras = _cameras(folder)
    frames = []
    for truth in sorted(folder.glob(f"*{LABELS_SUFFIX}")):
        stem = truth.name.removesuffix(LABELS_SUFFIX)
        photo = next((p for p in (folder / f"{stem}.png", folder / f"{stem}.jpg") if p.is_file()), None)
        if photo is not None:
            frames.append(_read(photo, truth, classes, sampled, cameras.get(stem)))
    polygons = folder / POLYGONS_FILE
    if polygons.is_file():
        taken = {frame.path.name for frame in frames}
        labels = LabelSet.load()
        for name, areas in read_polygons(polygons, labels).items():
            if name not in taken and (folder / name).is_file():
                frames.append(_named(folder / name, areas, labels, classes, polygons))
        frames.sort(key=lambda frame: frame.path.name)
    if not frames:
        raise RecordingError(
            f"{folder}: no frames; expected pictures NNNN.png or .jpg with NNNN{LABELS_SUFFIX} beside them, or "
            f"{POLYGONS_FILE} that names areas of them"
        )
    return frames


def holds_frames(folder: Path) -> bool:
    """Whether a folder has labels of pictures in one of the two forms."""
    return any(folder.glob(f"*{LABELS_SUFFIX}")) or (folder / POLYGONS_FILE).is_file()


def _named(photo: Path, areas: list[NamedArea], label_set: LabelSet, classes: int, source: Path) -> Frame:
    """A photo whose labels are the areas that were named in it."""
    check_picture(photo)
    image = cv2.imread(str(photo), cv2.IMREAD_COLOR)
    if image is None:
        raise ImageError(f"{photo}: cannot be read as a picture, though {source} names areas of it")
    labels = labels_of(areas, image.shape[0], image.shape[1], label_set)
    if ((labels >= classes) & (labels != UNLABELLED)).any():
        raise ImageError(f"{source}: names a class of {photo.name} that is none of the first {classes}")
    return Frame(np.ascontiguousarray(image[..., ::-1], dtype=np.uint8), labels, photo)


def _cameras(folder: Path) -> dict[str, Camera]:
    index = folder / _INDEX
    if not index.is_file():
        return {}
    entries = json.loads(index.read_text(encoding="utf-8"))["frames"]
    return {Path(entry["image"]).stem: _camera(entry["truth_camera"]) for entry in entries}


def _camera(values: dict[str, Any]) -> Camera:
    return Camera(**{**values, "distortion": tuple(values["distortion"])})


def _read(photo: Path, truth: Path, classes: int, sampled: bool, camera: Camera | None) -> Frame:
    image = cv2.imread(str(photo), cv2.IMREAD_COLOR)
    labels = cv2.imread(str(truth), cv2.IMREAD_UNCHANGED)
    if image is None or labels is None:
        raise ImageError(f"{photo if image is None else truth}: cannot be read as a picture; render the frame again")
    if sampled:
        labels = _spread(labels, image.shape[0], image.shape[1])
    if labels.shape != image.shape[:2] or labels.dtype != np.uint8:
        raise ImageError(f"{truth}: is {labels.shape} {labels.dtype}, expected {image.shape[:2]} uint8 like its photo")
    ids = np.unique(labels)
    wrong = ids[(ids >= classes) & (ids < LAND)]
    if wrong.size:
        raise ImageError(f"{truth}: holds label {wrong[0]}, expected ids below {classes} or {UNLABELLED}")
    inverse, ordinal = _inverse_depth(photo, camera, image.shape[:2])
    rgb = np.ascontiguousarray(image[..., ::-1], dtype=np.uint8)
    return Frame(rgb, np.asarray(labels, np.uint8), photo, inverse, ordinal)


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


def _inverse(depth: npt.NDArray[Any]) -> Float32Array:
    known = np.isfinite(depth) & (depth > 0)
    return np.asarray(np.divide(1.0, depth, out=np.full(depth.shape, np.nan), where=known), np.float32)


def _at_size(inverse: Float32Array, size: tuple[int, int]) -> Float32Array:
    if inverse.shape == size:
        return inverse
    return np.asarray(cv2.resize(inverse, size[::-1], interpolation=cv2.INTER_NEAREST), np.float32)


def _spread(labels: UInt8Array, height: int, width: int) -> UInt8Array:
    """Labels of every n-th pixel put at their places in a full image; any other shape is left as it is."""
    step = -(-height // labels.shape[0])
    full = np.full((height, width), UNLABELLED, np.uint8)
    if full[::step, ::step].shape != labels.shape or step == 1:
        return labels
    full[::step, ::step] = labels
    return full


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
        train=[f for name, path in sets.items() if name not in held_out for f in read_frames(path, classes)],
        validation=[f for name in split.validation for f in read_frames(sets[name], classes, sampled=True)],
        test=[f for name in split.test for f in read_frames(sets[name], classes, sampled=True)],
    )
