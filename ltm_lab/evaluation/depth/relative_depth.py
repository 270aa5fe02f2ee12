"""Scores networks of relative depth against true depth, after a robust fit of scale and shift to the truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ltm_core.base.errors import ModelError
from ltm_core.base.types import Float64Array
from ltm_core.depth.monocular import DepthNetwork, NetworkDepth
from ltm_core.depth.scale_fit import robust_line
from ltm_core.geometry.camera import Camera
from ltm_lab.evaluation.metrics.depth import RANGE_BINS
from ltm_lab.evaluation.metrics.depth_fit import at_pixels_of
from ltm_lab.training.training_frames import TrainingFrame

_PAIRS = 4000  # of pixels of a frame, whose order of near and far is compared
_CLEAR = 1.5  # ratio of true depths from which a pair has an order to be told


@dataclass(frozen=True)
class RelativeDepthScore:
    """`abs_rel`: mean of |estimate - truth| / truth by bin of `RANGE_BINS`, then over all; `pixels` counted in each.
    `order`: share of pairs, one pixel half as far again as the other or more, that the network has in order.
    `unfit`: frames on which no line could be laid; they count in `order` alone."""

    abs_rel: tuple[float, ...]
    pixels: tuple[int, ...]
    order: float
    frames: int
    unfit: int


def score_relative_depth(network: DepthNetwork, frames: Iterable[TrainingFrame], seed: int = 0) -> RelativeDepthScore:
    """Score a network on frames whose true depth is known; others are passed over.

    Raises ModelError for a metric network (its camera matters: `ltm-lab eval depth`).
    """
    sums, counts = np.zeros(len(RANGE_BINS) - 1), np.zeros(len(RANGE_BINS) - 1, np.int64)
    right = pairs = seen = unfit = 0
    for frame in frames:
        if frame.inverse is None or frame.ordinal:
            continue
        seen += 1
        height, width = frame.image.shape[:2]
        found = network.predict(frame.image, Camera.from_fov(width, height, 50.0))
        if found.kind == "metric":
            raise ModelError(
                f"{network.manifest.name}: gives metres, which need a camera; score it with ltm-lab eval depth"
            )
        values = at_pixels_of(found.values, (height, width), (height, width))
        known = np.isfinite(values) & np.isfinite(frame.inverse)
        x, true = values[known].astype(np.float64), 1.0 / frame.inverse[known].astype(np.float64)
        told, ordered = _order(found, x, true, np.random.default_rng([seed, seen]))
        right, pairs = right + ordered, pairs + told
        estimate = _metres(found, x, true)
        if estimate is None:
            unfit += 1
            continue
        index = np.digitize(true, RANGE_BINS) - 1
        error = np.abs(estimate - true) / true
        sums += np.bincount(index, error, len(sums))
        counts += np.bincount(index, minlength=len(counts))
    with np.errstate(invalid="ignore", divide="ignore"):
        by_bin = (*(sums / counts), sums.sum() / counts.sum())
    return RelativeDepthScore(
        tuple(float(value) for value in by_bin),
        (*(int(count) for count in counts), int(counts.sum())),
        right / pairs if pairs else float("nan"),
        seen,
        unfit,
    )


def _metres(found: NetworkDepth, x: Float64Array, true: Float64Array) -> Float64Array | None:
    """The network's depth in metres by the line that most pixels agree on in relative error; held between the true
    extremes. None where there is no such line, or it runs against the truth."""
    inverse = found.kind == "relative_inverse"
    y = 1.0 / true if inverse else true
    line = robust_line(x, y, weight=1.0 / y, floor=1e-3)
    if line is None or line.scale <= 0:
        return None
    fitted = np.clip(line.scale * x + line.shift, y.min(), y.max())
    return 1.0 / fitted if inverse else fitted


def _order(found: NetworkDepth, x: Float64Array, true: Float64Array, rng: np.random.Generator) -> tuple[int, int]:
    """Pairs that have an order to be told, and those that the network has right."""
    if not len(x):
        return 0, 0
    first, second = rng.integers(0, len(x), (2, _PAIRS))
    ratio = np.log(true[first] / true[second])
    clear = np.abs(ratio) > np.log(_CLEAR)
    nearer = x[second] - x[first] if found.kind == "relative_inverse" else x[first] - x[second]
    return int(clear.sum()), int((np.sign(nearer) == np.sign(ratio))[clear].sum())


def bin_names() -> tuple[str, ...]:
    """Names of the entries of a score: the range bins, then all."""
    names = [f"{near:g}-{far:g} m" if np.isfinite(far) else f"> {near:g} m" for near, far in pairwise(RANGE_BINS)]
    return (*names, "all")
