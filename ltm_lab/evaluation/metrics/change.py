"""Precision and recall of change masks against true masks."""

from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import RasterError
from ltm_core.base.types import BoolArray


@dataclass(frozen=True)
class ChangeScore:
    """Cells by what they are and what was found; ratios are NaN where nothing could be found or was."""

    hits: int
    false_alarms: int
    misses: int
    quiet: int
    """Cells without change that were not reported."""

    @property
    def cells(self) -> int:
        return self.hits + self.false_alarms + self.misses + self.quiet

    @property
    def precision(self) -> float:
        return _ratio(self.hits, self.hits + self.false_alarms)

    @property
    def recall(self) -> float:
        return _ratio(self.hits, self.hits + self.misses)

    @property
    def f1(self) -> float:
        return _ratio(2 * self.hits, 2 * self.hits + self.false_alarms + self.misses)

    @property
    def iou(self) -> float:
        return _ratio(self.hits, self.hits + self.false_alarms + self.misses)


def score_change(found: BoolArray, truth: BoolArray, observed: BoolArray | None = None) -> ChangeScore:
    """Score a mask (H, W) on the cells that are `observed` (default: all). Raises RasterError on other shapes."""
    looked = np.ones(truth.shape, np.bool_) if observed is None else observed
    if not found.shape == truth.shape == looked.shape:
        raise RasterError(f"change of {found.shape} against truth of {truth.shape}, observed {looked.shape}")
    return ChangeScore(
        int((found & truth & looked).sum()),
        int((found & ~truth & looked).sum()),
        int((~found & truth & looked).sum()),
        int((~found & ~truth & looked).sum()),
    )


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
