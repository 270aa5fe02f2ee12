"""A segmenter on labelled frames, and its time on photos."""

import time
from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from ltm_core.metrics.segmentation import SegmentationScore
from ltm_core.vision.segmenter import Segmenter


def score_segmenter(
    segmenter: Segmenter, pairs: Iterable[tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]]
) -> SegmentationScore:
    """Score over pairs of photo (H, W, 3) uint8 RGB and true labels (H, W) uint8 (255: truth unknown)."""
    score = SegmentationScore.empty(len(segmenter.labels))
    for image, truth in pairs:
        score = score.plus(truth, segmenter.segment(image).labels)
    return score


def segment_milliseconds(
    segmenter: Segmenter, images: Sequence[npt.NDArray[np.uint8]], repeats: int = 5
) -> npt.NDArray[np.float64]:
    """Wall time of `segment` in ms, of each call on each image, after one call that is not counted."""
    segmenter.segment(images[0])
    times = []
    for _ in range(repeats):
        for image in images:
            start = time.perf_counter()
            segmenter.segment(image)
            times.append((time.perf_counter() - start) * 1e3)
    return np.array(times)
