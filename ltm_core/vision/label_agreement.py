"""How sure a label is by those around it: where they say the same, it is right more often than its probability tells.

On photographs of towers a head's own probability ranks its errors badly; patches within another class, and the edges
between classes, are what is wrong. `ltm train head` prints what that gives, on photos held out.
"""

from __future__ import annotations

import cv2
import numpy as np
from pydantic import Field

from ltm_core.strict_model import StrictModel
from ltm_core.types import Float32Array


class Agreement(StrictModel):
    """`reach`: of the picture's width, standard deviation of the Gaussian that weighs what is around a pixel; 0: only
    the pixel itself counts. `exponent`: of the mean, so that it is the share of right labels; measured on photos."""

    reach: float = Field(default=0.0, ge=0, le=0.1)
    exponent: float = Field(default=1.0, gt=0, le=5)


def agreed(probabilities: Float32Array, rule: Agreement) -> Float32Array:
    """(h, w) how sure the likeliest of (K, h, w) probabilities is: the mean around the pixel of the probability where
    the same class is the likeliest, and 0 elsewhere, to the exponent."""
    winner, best = probabilities.argmax(axis=0), probabilities.max(axis=0)
    sigma = rule.reach * probabilities.shape[2]
    mean = np.zeros(best.shape, np.float32)
    for k in np.unique(winner):
        own = winner == k
        around = cv2.GaussianBlur(np.where(own, best, np.float32(0)), (0, 0), sigma)
        mean[own] = around[own]
    return np.asarray(np.clip(mean, 0, 1) ** np.float32(rule.exponent), np.float32)
