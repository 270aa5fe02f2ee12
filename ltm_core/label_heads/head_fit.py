"""Fit a label head to samples of labelled photos, and calibrate its probabilities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from pydantic import Field
from scipy import optimize

from ltm_core.base.errors import ImageError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, Float64Array, Int64Array
from ltm_core.label_heads.head_samples import PhotoSamples

_LAST_RIDGE: Final = 0.02
_BIAS_RIDGE: Final = 0.1
_LEAST_SPREAD: Final = 1e-3
_STEPS: Final = 300
_PARTS: Final = 3
"""Number of parts of the photos, the best value when five of 21 hand-labelled mountain photos trained heads for the
others."""


class HeadFitConfig(StrictModel):
    """Regularisation of a label head towards its network, and weights of the samples.

    `ridge`: penalty on the squares of the weights of coarse maps, of features brought to unit spread (of the last one,
    0.02). They hold more of the place than of the plant, and lead astray elsewhere: few places need 1, dozens bear
    less. `rarity`: a class counts in a photo as its area's share to this power: 1, each pixel alike, lets sky rule; 0,
    each class alike, a lake of a few pixels. Chosen on the five views of `hpwren_towers`, each site by heads that the
    others taught.
    """

    ridge: float = Field(default=1.0, gt=0)
    rarity: float = Field(default=0.8, ge=0, le=1)


@dataclass(frozen=True, eq=False)
class FittedHead:
    """Fitted label head. `weights`: (F, K) of features as in `PhotoSamples`; `bias`: (K,)."""

    weights: Float64Array
    bias: Float64Array


def fit_head(
    samples: Sequence[PhotoSamples],
    channels: Mapping[str, int],
    config: HeadFitConfig | None = None,
    one_view: bool = False,
) -> FittedHead:
    """Return the mean of label heads trained on two thirds of the photos each, so that a single photo has less weight.

    `channels`: those of each map, in the order of features. `one_view`: all of one view, whose head is taught by all.
    Raises ImageError where there is no sample.
    """
    config = config or HeadFitConfig()
    parts = min(_PARTS, len(samples))
    if one_view or parts < 2:
        return _best_head(samples, channels, config)
    heads = [
        _best_head([s for k, s in enumerate(samples) if k % parts != part], channels, config) for part in range(parts)
    ]
    return FittedHead(np.mean([h.weights for h in heads], axis=0), np.mean([h.bias for h in heads], axis=0))


def _best_head(samples: Sequence[PhotoSamples], channels: Mapping[str, int], config: HeadFitConfig) -> FittedHead:
    """Return the head that explains the samples best under the ridge."""
    labels = np.concatenate([s.labels for s in samples]) if samples else np.empty(0, np.uint8)
    if len(labels) == 0:
        raise ImageError("no labelled pixel in any photo; label areas first")
    scores, features = np.concatenate([s.scores for s in samples]), np.concatenate([s.features for s in samples])
    weight = np.concatenate([class_weights(s, config.rarity) for s in samples])
    weight /= weight.sum()
    mean, spread = features.mean(axis=0), features.std(axis=0) + _LEAST_SPREAD
    inputs = (features - mean) / spread
    count, size = scores.shape[1], features.shape[1]
    ridge = np.concatenate(
        [np.full(width, _LAST_RIDGE if name == "last" else config.ridge) for name, width in channels.items()]
    )[:, None]
    truth = np.eye(count)[labels]

    def cost(values: Float64Array) -> tuple[float, Float64Array]:
        matrix, bias = values[:-count].reshape(size, count), values[-count:]
        total = scores + inputs @ matrix + bias
        total -= total.max(axis=1, keepdims=True)
        logarithm = total - np.log(np.exp(total).sum(axis=1, keepdims=True))
        loss = -(weight * logarithm[np.arange(len(labels)), labels]).sum()
        loss += 0.5 * (ridge * matrix**2).sum() + 0.5 * _BIAS_RIDGE * (bias**2).sum()
        slope = weight[:, None] * (np.exp(logarithm) - truth)
        by_matrix, by_bias = inputs.T @ slope + ridge * matrix, slope.sum(axis=0) + _BIAS_RIDGE * bias
        return float(loss), np.concatenate([by_matrix.ravel(), by_bias])

    start = np.zeros((size + 1) * count)
    best = optimize.minimize(cost, start, jac=True, method="L-BFGS-B", options={"maxiter": _STEPS}).x
    matrix = best[:-count].reshape(size, count) / spread[:, None]
    return FittedHead(matrix, best[-count:] - mean @ matrix)


def class_weights(samples: PhotoSamples, rarity: float) -> Float64Array:
    """Return (N,) weights of the samples of a photo; those of a class sum to a power of its share."""
    counts = np.bincount(samples.labels, minlength=len(samples.shares))
    each = samples.shares**rarity / np.maximum(counts, 1)
    return np.asarray(each[samples.labels], np.float64)


TEMPERATURES = (0.2, 8.0)  # of temperatures; at either end something other than the temperature is wrong
_EXPONENTS = 5.0  # the largest of agreement; the least is that of temperatures
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

    bounds = (float(np.log(TEMPERATURES[0])), float(np.log(_EXPONENTS)))
    return float(np.exp(optimize.minimize_scalar(cost, bounds=bounds, method="bounded").x))


def balanced(confusions: Sequence[Int64Array]) -> Float64Array:
    """Return P(label given | true label), (K, K), rows sum to 1, from the confusion matrices of several sets.

    Each set that holds a class counts alike in its row, whatever its number of pixels, less one of which the class is
    less than a fiftieth; (K, K + 1) matrices lose their column of unlabelled pixels. A class that no set holds gets a
    row that is mostly itself: nothing is known of it.
    """
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
