"""Scores proposed masks against areas that a person has drawn, camera by camera."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from pydantic import Field

from ltm_core.base.errors import ConfigError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.storage.config_io import checked
from ltm_core.storage.text_io import LARGEST_TABLE, read_text
from ltm_core.vision.mask_proposals import Proposal
from ltm_core.vision.masks import MaskPolygon, fill

RIGHT = 0.6
"""Share of a proposal that must lie in what was drawn, a hundredth of the width more generously, to be right."""
FOUND = 0.5
"""Share of a drawn area that must be proposed, for it not to be missed."""


class MaskTruth(StrictModel):
    """What one camera's mask should hide."""

    camera: str
    pictures: tuple[str, ...] = Field(min_length=1)
    areas: tuple[MaskPolygon, ...] = Field(min_length=1)


class _Truths(StrictModel):
    cameras: tuple[MaskTruth, ...] = Field(min_length=1)


def read_mask_truths(path: Path) -> tuple[MaskTruth, ...]:
    """A JSON list of cameras, each with its pictures and areas (class, polygon). Raises ConfigError."""
    try:
        content = json.loads(read_text(path, LARGEST_TABLE, ConfigError))
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not JSON ({error})") from error
    return checked(_Truths, {"cameras": content}, str(path), unnamed=("cameras",)).cameras


@dataclass(frozen=True)
class MaskScore:
    """Of one class and camera, or the sum of cameras: proposals that are right and wrong, drawn areas and those of them
    that are missed, and pixels: of both, of either."""

    right: int = 0
    wrong: int = 0
    areas: int = 0
    missed: int = 0
    both: int = 0
    either: int = 0

    @property
    def iou(self) -> float:
        """NaN where there is nothing."""
        return self.both / self.either if self.either else float("nan")

    def __add__(self, other: MaskScore) -> MaskScore:
        return MaskScore(
            self.right + other.right,
            self.wrong + other.wrong,
            self.areas + other.areas,
            self.missed + other.missed,
            self.both + other.both,
            self.either + other.either,
        )


def score_proposals(
    proposals: Sequence[Proposal], truth: MaskTruth, shape: tuple[int, int], kind: str | None = None
) -> MaskScore:
    """Of pictures of this size (H, W). `kind`: proposals and areas of this class alone; None: of all. A proposal is
    judged by all that was drawn: a mast that is called a lens is hidden all the same."""
    drawn = [(area.kind, _drawn(area, shape)) for area in truth.areas]
    every = np.logical_or.reduce([hidden for _, hidden in drawn])
    generous = cv2.dilate(every.astype(np.uint8), _disc(shape)) > 0
    chosen = [p for p in proposals if kind in (None, p.kind)]
    proposed = np.logical_or.reduce([p.hidden for p in proposals]) if proposals else np.zeros(shape, np.bool_)
    wanted = [hidden for name, hidden in drawn if kind in (None, name)]
    right = sum(float(generous[p.hidden].mean()) >= RIGHT for p in chosen)
    missed = sum(float(proposed[hidden].mean()) < FOUND for hidden in wanted)
    a = np.logical_or.reduce([p.hidden for p in chosen]) if chosen else np.zeros(shape, np.bool_)
    b = np.logical_or.reduce(wanted) if wanted else np.zeros(shape, np.bool_)
    return MaskScore(right, len(chosen) - right, len(wanted), missed, int((a & b).sum()), int((a | b).sum()))


def _drawn(area: MaskPolygon, shape: tuple[int, int]) -> BoolArray:
    drawn = np.zeros(shape, np.uint8)
    fill(drawn, area.polygon)
    return drawn > 0


def _disc(shape: tuple[int, int]) -> UInt8Array:
    size = 2 * max(1, round(0.01 * shape[1])) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), np.uint8)
