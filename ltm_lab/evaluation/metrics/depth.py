"""Depth errors against truth, by range bin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RANGE_BINS = (0.0, 100.0, 300.0, 1000.0, np.inf)
"""Edges of the range bins that depth is scored in, metres of true depth."""


@dataclass(frozen=True)
class DepthScore:
    """Errors of one range bin, metres; NaN where no pixel counts."""

    near: float
    far: float
    pixels: int
    rmse: float
    mae: float
    median: float
    """Median absolute error."""
    bias: float
    """Mean of estimate minus truth."""
