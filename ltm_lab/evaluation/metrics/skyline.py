"""Skylines of label and depth images, and their error in rows against the true skyline."""

from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import ImageError
from ltm_core.base.types import BoolArray, Float32Array


@dataclass(frozen=True)
class SkylineScore:
    """Errors in rows of the image, positive where the estimate lies lower (sees more sky); NaN without a column.

    `columns`: those that were compared. `missed`: columns with a true skyline for which the estimate has none.
    `resolution`: rows between the truth's samples; each error is known to half of that."""

    columns: int
    missed: int
    mean: float
    """Mean size of the error."""
    median: float
    p95: float
    bias: float
    resolution: int


def skyline(sky: BoolArray, unknown: BoolArray | None = None) -> Float32Array:
    """The first row below the sky in each column of a mask (H, W), (W,) float32.

    NaN in columns that do not begin with sky, are sky throughout, or whose sky ends at a pixel that is `unknown`."""
    height = sky.shape[0]
    row = np.where(sky.all(axis=0), height, np.argmin(sky, axis=0))
    usable = (row > 0) & (row < height)
    if unknown is not None:
        usable &= ~unknown[np.minimum(row, height - 1), np.arange(sky.shape[1])]
    return np.where(usable, row, np.nan).astype(np.float32)


def depth_skyline(depth: Float32Array) -> Float32Array:
    """The skyline of a depth or range image (H, W): sky is +inf, unknown NaN."""
    return skyline(np.isposinf(depth), np.isnan(depth))


class SkylineTally:
    """Skyline errors gathered frame by frame, in columns that the truth samples."""

    def __init__(self) -> None:
        self._errors: list[Float32Array] = []
        self._missed = 0
        self._step = 1

    def add(self, estimate: Float32Array, truth: Float32Array, step: int = 1) -> None:
        """Count one pair of skylines (W,): the estimate of every column, truth of every `step`-th, in its own rows.

        The truth says that the skyline lies between two of its rows; the middle is taken. Raises ImageError where the
        widths do not fit."""
        sampled = estimate[::step]
        if sampled.shape != truth.shape:
            raise ImageError(
                f"skyline of {estimate.shape} columns, every {step}. taken, against truth of {truth.shape}"
            )
        true = truth * step - (step - 1) / 2
        known = np.isfinite(true)
        both = known & np.isfinite(sampled)
        self._errors.append((sampled - true)[both].astype(np.float32))
        self._missed += int((known & ~both).sum())
        self._step = step

    def score(self) -> SkylineScore:
        errors = np.concatenate(self._errors) if self._errors else np.empty(0, np.float32)
        if errors.size == 0:
            return SkylineScore(0, self._missed, np.nan, np.nan, np.nan, np.nan, self._step)
        size = np.abs(errors)
        return SkylineScore(
            errors.size,
            self._missed,
            float(size.mean()),
            float(np.median(size)),
            float(np.percentile(size, 95)),
            float(errors.mean()),
            self._step,
        )
