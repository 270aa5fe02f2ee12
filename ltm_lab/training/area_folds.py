"""Parts the named areas of photos of one view into folds, so that some teach a head and the others judge it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Int64Array
from ltm_core.vision.labels import UNLABELLED
from ltm_lab.training.labelled_frames import Frame

FOLDS: Final = 4
_CUTS: Final = 8


def by_area(frames: Sequence[Frame], folds: int = FOLDS) -> tuple[list[Frame], list[str]]:
    """Each photo once for each fold that has areas of it, with the labels of these alone, and the folds' names.

    An area is what hangs together of one class, cut where it passes an eighth of the picture's width. Those of a class
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
    """(H, W) number of each area, from 1 on; 0 where nothing is named."""
    side = max(1, -(-named.shape[1] // _CUTS))
    found, last = np.zeros(named.shape, np.int64), 0
    for down in range(0, named.shape[0], side):
        for across in range(0, named.shape[1], side):
            block = np.s_[down : down + side, across : across + side]
            count, parts = cv2.connectedComponents(named[block].astype(np.uint8))
            found[block] = np.where(parts > 0, parts + last, 0)
            last += count - 1
    return found
