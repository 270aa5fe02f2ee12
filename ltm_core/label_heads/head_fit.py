"""Draw training samples of a label head from labelled photos, group the photos into folds, and fit the head.

A sample is a pixel of known class with the network's scores and decoder maps. Photos of one site are in one group; of a
single view, its areas are dealt into folds instead."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import scipy  # loads its parts when they are first used

from ltm_core.base.errors import ImageError, RecordingError
from ltm_core.base.types import BoolArray, Float64Array, Int64Array, UInt8Array
from ltm_core.fuel.label_measurement import fit_softmax
from ltm_core.label_heads.labelled_frames import Frame
from ltm_core.storage.config_io import LARGEST_TABLE, read_text
from ltm_core.vision.labels import UNLABELLED
from ltm_core.vision.segmenter import Segmenter

SITES_FILE: Final = "sites.csv"
_FOLDS: Final = 4
_CUTS: Final = 8
_MOST: Final = 1500  # pixels of one class in one photo: neighbours say the same
_RIDGE: Final = 1.0
"""Penalty on the squares of the weights of coarse maps, of features brought to unit spread: they hold more of the place
than of the plant, and lead astray elsewhere. Chosen, as `_RARITY`, on the five views of `hpwren_towers`, each site by
heads that the others taught."""
_LAST_RIDGE: Final = 0.02
_RARITY: Final = 0.8
"""A class counts in a photo as its area's share to this power: 1, each pixel alike, lets sky rule; 0, each class alike,
a lake of a few pixels."""
_BIAS_RIDGE: Final = 0.1
_LEAST_SPREAD: Final = 1e-3
_PARTS: Final = 3
"""Number of parts of the photos, the best value when five of 21 hand-labelled mountain photos trained heads for the
others."""


@dataclass(frozen=True, eq=False)
class PhotoSamples:
    """Pixels of one photo. `labels` (N,) uint8; `scores` (N, K) float64 of the network; `features` (N, F) float64, its
    maps' values side by side; `shares` (K,) of the photo's area labelled with each class."""

    site: str
    labels: UInt8Array
    scores: Float64Array
    features: Float64Array
    shares: Float64Array


def photo_samples(segmenter: Segmenter, frame: Frame, site: str, rng: np.random.Generator) -> PhotoSamples:
    """Return at most _MOST random pixels of each class, at the places of the network's own grid."""
    scores, maps = segmenter.scores_and_maps(frame.image)
    count, rows, cols = scores.shape
    height, width = frame.labels.shape
    # The label of the photo's pixel at the middle of each of the network's.
    down, across = (((np.arange(n) + 0.5) * size / n).astype(int) for n, size in ((rows, height), (cols, width)))
    truth = frame.labels[np.ix_(down, across)].reshape(-1)
    places = np.concatenate([rng.permutation(np.flatnonzero(truth == k))[:_MOST] for k in range(count)])
    planes = [cv2.resize(one, (cols, rows), interpolation=cv2.INTER_LINEAR) for plane in maps.values() for one in plane]
    at_places = (np.reshape(values, (-1, rows * cols))[:, places].T.astype(np.float64) for values in (scores, planes))
    shares = np.bincount(frame.labels[frame.labels < count], minlength=count) / frame.labels.size
    own, features = at_places
    return PhotoSamples(site, truth[places], own, features, shares)


def sites_of(frames: list[Frame]) -> list[str]:
    """Return the site of each photo: by `sites.csv` (columns image, site) beside it, else its name up to the first `_`.
    Raises RecordingError for such a file without these columns."""
    named = {folder: _read_sites(folder / SITES_FILE) for folder in {frame.path.parent for frame in frames}}
    return [named[f.path.parent].get(f.path.name, f.path.stem.partition("_")[0]) for f in frames]


def _read_sites(path: Path) -> Mapping[str, str]:
    if not path.is_file():
        return {}
    rows = csv.DictReader(read_text(path, LARGEST_TABLE, RecordingError).splitlines())
    if not {"image", "site"} <= set(rows.fieldnames or ()):
        raise RecordingError(f"{path}: has columns {', '.join(rows.fieldnames or ())}; expected image, site")
    return {row["image"]: row["site"] for row in rows}


def by_area(frames: Sequence[Frame]) -> tuple[list[Frame], list[str]]:
    """Return each photo once for each fold with areas in it, with the labels of these only, and the folds' names. An
    area is what hangs together of one class, cut where it passes an eighth of the image's width. Those of a class go to
    the folds in turn, the largest first, so that a class of two areas is in two folds."""
    parts, names = [], []
    turn: dict[int, int] = {}
    for frame in frames:
        labels = [np.full_like(frame.labels, UNLABELLED) for _ in range(_FOLDS)]
        for label in np.unique(frame.labels[frame.labels != UNLABELLED]):
            areas = _areas(frame.labels == label)
            sizes = np.bincount(areas.ravel())
            for area in sorted(range(1, len(sizes)), key=lambda k: -int(sizes[k])):
                fold = turn.get(int(label), 0)
                labels[fold % _FOLDS][areas == area] = label
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


Fitted = tuple[Float64Array, Float64Array]
"""Weights (F, K) of features as in `PhotoSamples`, and bias (K,)."""


def fit_head(samples: Sequence[PhotoSamples], channels: Mapping[str, int], one_view: bool = False) -> Fitted:
    """Return the mean of label heads trained on two thirds of the photos each, so that a single photo has less weight.
    `channels`: those of each map, in the order of features. `one_view`: all of one view, whose head is taught by all.
    Raises ImageError where there is no sample."""
    parts = min(_PARTS, len(samples))
    if one_view or parts < 2:
        return _best_head(samples, channels)
    heads = [_best_head([s for k, s in enumerate(samples) if k % parts != part], channels) for part in range(parts)]
    weights, biases = zip(*heads, strict=True)
    return np.mean(weights, axis=0), np.mean(biases, axis=0)


def _best_head(samples: Sequence[PhotoSamples], channels: Mapping[str, int]) -> Fitted:
    """Return the head that explains the samples best under the ridge."""
    labels = np.concatenate([s.labels for s in samples]) if samples else np.empty(0, np.uint8)
    if len(labels) == 0:
        raise ImageError("no labelled pixel in any photo; label areas first")
    scores, features = np.concatenate([s.scores for s in samples]), np.concatenate([s.features for s in samples])
    weight = np.concatenate([class_weights(s) for s in samples])
    mean, spread = features.mean(axis=0), features.std(axis=0) + _LEAST_SPREAD
    inputs = np.column_stack([(features - mean) / spread, np.ones(len(labels))])
    of_maps = [np.full(width, _LAST_RIDGE if name == "last" else _RIDGE) for name, width in channels.items()]
    ridge = np.concatenate([*of_maps, [_BIAS_RIDGE]])[:, None]
    best = fit_softmax(inputs, np.eye(scores.shape[1])[labels], weight / weight.sum(), ridge, scores)
    weights = best[:-1] / spread[:, None]
    return weights, best[-1] - mean @ weights


def class_weights(samples: PhotoSamples) -> Float64Array:
    """Return (N,) weights of the samples of a photo; those of a class sum to a power of its share."""
    counts = np.bincount(samples.labels, minlength=len(samples.shares))
    each = samples.shares**_RARITY / np.maximum(counts, 1)
    return np.asarray(each[samples.labels], np.float64)


_EXPONENTS = 0.2, 5.0  # least and largest exponent of the confidence
_ENOUGH = 0.02  # of a set's pixels: a class of fewer is known the less from that set
_PRIOR = 1e-3  # of a row of the confusion matrix, given to each entry: what was never seen is not impossible


def fit_exponent(photos: Sequence[tuple[Float64Array, BoolArray]]) -> float:
    """Return the exponent with which the confidence (N,) of labels, 0 to 1, best predicts which are right (N,), in
    photos of equal weight; 1 without photos."""
    known = [(np.log(np.clip(sure, 1e-3, 1 - 1e-3)), right) for sure, right in photos if len(sure)]
    if not known:
        return 1.0

    def cost(log_exponent: float) -> float:
        exponent = np.exp(log_exponent)
        return float(
            -sum(np.where(right, exponent * logs, np.log(-np.expm1(exponent * logs))).mean() for logs, right in known)
        )

    bounds = tuple(np.log(_EXPONENTS))
    return float(np.exp(scipy.optimize.minimize_scalar(cost, bounds=bounds, method="bounded").x))


def balanced(confusions: Sequence[Int64Array]) -> Float64Array:
    """Return P(label given | true label), (K, K), rows sum to 1, from the confusion matrices of several sets. Each set
    that holds a class counts alike in its row, whatever its number of pixels, less one of which the class is less than
    a fiftieth; (K, K + 1) matrices lose their column of unlabelled pixels. A class that no set holds gets a row that is
    mostly itself: nothing is known of it."""
    classes = len(confusions[0])
    rows = np.zeros((classes, classes))
    for confusion in confusions:
        counts = np.asarray(confusion[:, :classes], np.float64)
        total = counts.sum(axis=1, keepdims=True)
        trust = np.minimum(total / max(_ENOUGH * total.sum(), 1e-9), 1.0)
        rows += trust * np.divide(counts, total, out=np.zeros_like(counts), where=total > 0)
    unseen = rows.sum(axis=1) == 0
    rows[unseen] = (0.5 * np.eye(classes) + 0.5 / classes)[unseen]
    rows = rows / rows.sum(axis=1, keepdims=True) + _PRIOR
    return np.asarray(rows / rows.sum(axis=1, keepdims=True))
