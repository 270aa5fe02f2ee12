"""Temperature scaling: calibrates a network's probabilities, and estimates its confusion between classes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import optimize

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int64Array, UInt8Array

_RANGE = (0.2, 8.0)  # of temperatures; at either end something other than the temperature is wrong
_EXPONENTS = 5.0  # the largest of agreement; the least is that of temperatures
_ENOUGH = 0.02  # of a set's pixels: a class of fewer is known the less from that set
_PRIOR = 1e-3  # of a row of the confusion matrix, given to each entry: what was never seen is not impossible


def fit_temperature(logits: Float32Array, labels: UInt8Array) -> float:
    """The temperature T for which softmax(logits / T) explains the labels best (Guo et al. 2017).

    `logits` (N, K) of pixels whose true label (N,) is known, below K. Raises ImageError where there are none.
    """
    if len(logits) == 0 or logits.shape[0] != labels.shape[0]:
        raise ImageError(f"logits {logits.shape} and labels {labels.shape}: expected (N, K) and (N,), N > 0")
    scores = np.asarray(logits, np.float64)
    rows = np.arange(len(scores))

    def cost(log_temperature: float) -> float:
        scaled = scores * np.exp(-log_temperature)
        top = scaled.max(axis=1)
        normaliser = top + np.log(np.exp(scaled - top[:, None]).sum(axis=1))
        return float((normaliser - scaled[rows, labels]).mean())

    bounds = (float(np.log(_RANGE[0])), float(np.log(_RANGE[1])))
    return float(np.exp(optimize.minimize_scalar(cost, bounds=bounds, method="bounded").x))


def fit_exponent(photos: Sequence[tuple[Float64Array, BoolArray]]) -> float:
    """The exponent that makes how sure labels are (N,), 0 to 1, explain best which are right (N,), in photos that
    count alike, whatever their number of pixels; 1 where no photo has any."""
    known = [(np.log(np.clip(sure, 1e-3, 1 - 1e-3)), right) for sure, right in photos if len(sure)]
    if not known:
        return 1.0

    def cost(log_exponent: float) -> float:
        exponent = np.exp(log_exponent)
        return float(
            -sum(np.where(right, exponent * logs, np.log(-np.expm1(exponent * logs))).mean() for logs, right in known)
        )

    bounds = (float(np.log(_RANGE[0])), float(np.log(_EXPONENTS)))
    return float(np.exp(optimize.minimize_scalar(cost, bounds=bounds, method="bounded").x))


def balanced(confusions: Sequence[Int64Array]) -> Float64Array:
    """P(label given | true label), (K, K), rows sum to 1, from the confusion matrices of several sets.

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
