"""Read frames with their labels, to train or to score a label network.

A set is a folder of images `NAME.png` or `NAME.jpg`, each with `NAME_labels.png` (uint8 ids), or with areas that a
person named in the folder's `polygons.json`. If an image has both, the PNG is used."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeVar

import numpy as np

from ltm_core.base.errors import ImageError, RecordingError
from ltm_core.base.types import UInt8Array
from ltm_core.storage.image_io import read_rgb, read_values
from ltm_core.vision.areas import ERASED, MASKED, POLYGONS_FILE, NamedArea, labels_of, read_areas
from ltm_core.vision.labels import UNLABELLED, LabelSet
from ltm_core.vision.overlays import scene_of

LABELS_SUFFIX = "_labels.png"
INDEX_FILE: Final = "frames.json"
"""Index file of a simulated set."""
UNKNOWN: Final = 254
"""Training label of a pixel of which nothing is known (255: it is not sky)."""
LAND: Final = 253
"""Training label of a slope of unknown cover: neither sky nor water nor built."""
_NO_CLASS: Final = (ERASED, MASKED, "lens", "caption", "bar")
"""Areas without ground truth: unknown, or hidden by `ltm mask`."""


@dataclass(frozen=True)
class Frame:
    """A photo (H, W, 3) uint8 RGB and the class of each pixel (H, W) uint8 (255 unlabelled)."""

    image: UInt8Array
    labels: UInt8Array
    path: Path

    @property
    def rendered(self) -> bool:
        """Return whether the frame belongs to a simulated set."""
        return (self.path.parent / INDEX_FILE).is_file()


def read_frames(folder: Path, classes: int, sampled: bool = False) -> list[Frame]:
    """Read the labelled frames of a folder, in order of name. With `sampled`, labels may also be those of every n-th
    pixel (`full[::n, ::n]`); the pixels between are then 255: enough to score, not to train. Raises RecordingError
    where there is no frame, or no such list of areas; ImageError where an image cannot be read, its labels have another
    size, or hold an id that is none of `classes`, LAND, UNKNOWN and 255."""
    frames = []
    for truth in sorted(folder.glob(f"*{LABELS_SUFFIX}")):
        stem = truth.name.removesuffix(LABELS_SUFFIX)
        photo = next((p for p in (folder / f"{stem}.png", folder / f"{stem}.jpg") if p.is_file()), None)
        if photo is not None:
            frames.append(_read(photo, truth, classes, sampled))
    polygons = folder / POLYGONS_FILE
    if polygons.is_file():
        taken, known = {frame.path.name for frame in frames}, LabelSet.load()
        for name, areas in read_polygons(polygons, known).items():
            if name not in taken and (folder / name).is_file():
                image = read_rgb(folder / name)
                labels = labels_of(areas, image.shape[0], image.shape[1], known)
                if ((labels >= classes) & (labels != UNLABELLED)).any():
                    raise ImageError(f"{polygons}: a class of {name} is not among the first {classes}")
                frames.append(Frame(scene_of(image), labels, folder / name))
        frames.sort(key=lambda frame: frame.path.name)
    if not frames:
        raise RecordingError(
            f"{folder}: no frames; expected images NNNN.png or .jpg with NNNN{LABELS_SUFFIX} beside them, or "
            f"{POLYGONS_FILE} that labels areas in them"
        )
    return frames


def without_classes(frames: Sequence[Frame], classes: Sequence[int]) -> list[Frame]:
    """Return the frames with the pixels of `classes` unlabelled, so that they count neither for nor against a label."""
    unlabelled = np.uint8(UNLABELLED)
    return [replace(f, labels=np.where(np.isin(f.labels, classes), unlabelled, f.labels)) for f in frames]


def read_polygons(path: Path, labels: LabelSet) -> dict[str, list[NamedArea]]:
    """Return the areas of each photo, in the order of the file. Raises ConfigError as `read_areas`; RecordingError for
    an unknown class, and a photo that is in another folder."""
    named: dict[str, list[NamedArea]] = {}
    for place, area in enumerate(read_areas(path)):
        if area.kind not in labels.names and area.kind not in _NO_CLASS:
            known = ", ".join((*labels.names, *_NO_CLASS))
            raise RecordingError(f"{path}: area {place} is of class {area.kind!r}; classes: {known}")
        if Path(area.image).name != area.image or not area.image.isprintable():
            raise RecordingError(
                f"{path}: area {place}: image is {area.image!r}, expected the name of a file beside it"
            )
        named.setdefault(area.image, []).append(area)
    return named


def _read(photo: Path, truth: Path, classes: int, sampled: bool) -> Frame:
    image, labels = read_rgb(photo), read_values(truth)
    if sampled:
        labels = _spread(labels, image.shape[0], image.shape[1])
    if labels.shape != image.shape[:2] or labels.dtype != np.uint8:
        raise ImageError(f"{truth}: is {labels.shape} {labels.dtype}, expected {image.shape[:2]} uint8 like its photo")
    wrong = labels[(labels >= classes) & (labels < LAND)]
    if wrong.size:
        raise ImageError(f"{truth}: contains label {wrong[0]}; expected ids below {classes} or {UNLABELLED}")
    return Frame(scene_of(image), np.asarray(labels, np.uint8), photo)


def _spread(labels: UInt8Array, height: int, width: int) -> UInt8Array:
    """Return the labels of every n-th pixel put at their places in a full image; any other shape is unchanged."""
    step, full = -(-height // labels.shape[0]), np.full((height, width), UNLABELLED, np.uint8)
    if full[::step, ::step].shape != labels.shape or step == 1:
        return labels
    full[::step, ::step] = labels
    return full


T = TypeVar("T")


def evenly(items: Sequence[T], most: int) -> list[T]:
    """Return at most `most` of the items, in order and evenly spaced from the first to the last."""
    if len(items) <= most:
        return list(items)
    return [items[i] for i in np.linspace(0, len(items) - 1, most).round().astype(int)]
