"""Takes classes out of the truth of labelled frames, where a set means something else by them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ltm_core.vision.labels import UNLABELLED
from ltm_lab.training.labelled_frames import Frame


def without_classes(frames: Sequence[Frame], classes: Sequence[int]) -> list[Frame]:
    """The frames, pixels of `classes` unlabelled: they count neither for nor against an answer."""
    if not classes:
        return list(frames)
    return [
        replace(frame, labels=np.where(np.isin(frame.labels, classes), np.uint8(UNLABELLED), frame.labels))
        for frame in frames
    ]
