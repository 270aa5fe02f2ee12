"""Draw training samples of a label head from labelled photos, and group the photos into folds.

A sample is a pixel of known class with the network's scores and decoder maps. Photos of one site are in one group; of a
single view, its areas are dealt into folds instead.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from ltm_core.base.errors import RecordingError
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int64Array, UInt8Array
from ltm_core.label_heads.labelled_frames import Frame
from ltm_core.storage.text_io import LARGEST_TABLE, read_text
from ltm_core.vision.labels import UNLABELLED
from ltm_core.vision.segmenter import Segmenter

SITES_FILE: Final = "sites.csv"
FOLDS: Final = 4
_CUTS: Final = 8
_MOST: Final = 1500  # pixels of one class in one photo: neighbours say the same


@dataclass(frozen=True, eq=False)
class PhotoSamples:
    """Pixels of one photo. `labels` (N,) uint8; `scores` (N, K) float64 of the network; `features` (N, F) float64, its
    maps' values side by side; `shares` (K,) of the photo's area labelled with each class."""

    site: str
    labels: UInt8Array
    scores: Float64Array
    features: Float64Array
    shares: Float64Array


def photo_samples(
    segmenter: Segmenter, frame: Frame, site: str, rng: np.random.Generator, most: int = _MOST
) -> PhotoSamples:
    """Return at most `most` random pixels of each class, at the places of the network's own grid."""
    scores, maps = segmenter.scores_and_maps(frame.image)
    count, rows, cols = scores.shape
    truth = _at_grid(frame.labels, rows, cols).reshape(-1)
    known = [rng.permutation(np.flatnonzero(truth == k))[:most] for k in range(count)]
    places = np.concatenate(known)
    features = np.concatenate([_enlarged(plane, rows, cols) for plane in maps.values()]).reshape(-1, rows * cols)
    shares = np.bincount(frame.labels[frame.labels < count], minlength=count) / frame.labels.size
    return PhotoSamples(
        site,
        truth[places],
        scores.reshape(count, -1)[:, places].T.astype(np.float64),
        features[:, places].T.astype(np.float64),
        shares,
    )


def sites_of(frames: list[Frame]) -> list[str]:
    """Return the site of each photo: by `sites.csv` (columns image, site) beside it, else its name up to the first `_`.

    Raises RecordingError for such a file without these columns.
    """
    named: dict[Path, Mapping[str, str]] = {}
    sites = []
    for frame in frames:
        folder = frame.path.parent
        if folder not in named:
            named[folder] = _read_sites(folder / SITES_FILE)
        sites.append(named[folder].get(frame.path.name, frame.path.stem.partition("_")[0]))
    return sites


def _read_sites(path: Path) -> Mapping[str, str]:
    if not path.is_file():
        return {}
    rows = csv.DictReader(read_text(path, LARGEST_TABLE, RecordingError).splitlines())
    if not {"image", "site"} <= set(rows.fieldnames or ()):
        raise RecordingError(f"{path}: has columns {', '.join(rows.fieldnames or ())}; expected image, site")
    return {row["image"]: row["site"] for row in rows}


def _at_grid(labels: UInt8Array, rows: int, cols: int) -> UInt8Array:
    """Return the label of the photo's pixel at the middle of each of the network's."""
    height, width = labels.shape
    down = ((np.arange(rows) + 0.5) * height / rows).astype(np.int64)
    across = ((np.arange(cols) + 0.5) * width / cols).astype(np.int64)
    return labels[np.ix_(down, across)]


def _enlarged(planes: Float32Array, rows: int, cols: int) -> Float32Array:
    if planes.shape[1:] == (rows, cols):
        return planes
    return np.stack([cv2.resize(plane, (cols, rows), interpolation=cv2.INTER_LINEAR) for plane in planes])


def by_area(frames: Sequence[Frame], folds: int = FOLDS) -> tuple[list[Frame], list[str]]:
    """Return each photo once for each fold with areas in it, with the labels of these only, and the folds' names.

    An area is what hangs together of one class, cut where it passes an eighth of the image's width. Those of a class
    go to the folds in turn, the largest first, so that a class of two areas is in two folds.
    """
    parts, names = [], []
    turn: dict[int, int] = {}
    for frame in frames:
        labels = [np.full_like(frame.labels, UNLABELLED) for _ in range(folds)]
        for label in np.unique(frame.labels[frame.labels != UNLABELLED]):
            areas = _areas(frame.labels == label)
            sizes = np.bincount(areas.ravel())
            for area in sorted(range(1, len(sizes)), key=lambda k: -int(sizes[k])):
                fold = turn.get(int(label), 0)
                labels[fold % folds][areas == area] = label
                turn[int(label)] = fold + 1
        for fold, part in enumerate(labels):
            if (part != UNLABELLED).any():
                parts.append(replace(frame, labels=part))
                names.append(f"areas {fold + 1}")
    return parts, names


def _areas(named: BoolArray) -> Int64Array:
    """Return (H, W) number of each area, from 1 on; 0 where nothing is named."""
    side = max(1, -(-named.shape[1] // _CUTS))
    found, last = np.zeros(named.shape, np.int64), 0
    for down in range(0, named.shape[0], side):
        for across in range(0, named.shape[1], side):
            block = np.s_[down : down + side, across : across + side]
            count, parts = cv2.connectedComponents(named[block].astype(np.uint8))
            found[block] = np.where(parts > 0, parts + last, 0)
            last += count - 1
    return found
