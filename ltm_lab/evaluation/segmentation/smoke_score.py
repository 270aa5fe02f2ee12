"""Scores what is told of smoke before the land, on pairs of photos of one view in which a person drew it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from pydantic import Field, TypeAdapter, ValidationError

from ltm_core.base.errors import ConfigError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import UInt8Array
from ltm_core.storage.text_io import LARGEST_TABLE, read_text
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.masks import MOST_POINTS, Point
from ltm_core.vision.smoke import APART_S, SmokeMemory


class SmokePair(StrictModel):
    """Two photos of one view, the later one with smoke in polygons (u, v); of smoke before the sky nothing is asked."""

    earlier: str
    later: str
    smoke: tuple[tuple[Point, ...], ...] = Field(max_length=MOST_POINTS)


@dataclass(frozen=True)
class SmokeScore:
    """Pixels of the later photo that its network calls land: `in_smoke`, of those `told`; `beside` smoke, of those
    `wrong`: told though there is none. `hidden`: all pixels that a person drew."""

    hidden: int
    in_smoke: int
    told: int
    beside: int
    wrong: int


def read_pairs(path: Path) -> list[SmokePair]:
    """Raises ConfigError."""
    try:
        return TypeAdapter(list[SmokePair]).validate_json(read_text(path, LARGEST_TABLE, ConfigError))
    except (ValidationError, json.JSONDecodeError) as error:
        raise ConfigError(f"{path}: {error}") from error


def score_pair(
    pair: SmokePair, photos: tuple[UInt8Array, UInt8Array], labels: tuple[UInt8Array, UInt8Array]
) -> SmokeScore:
    """`photos` (H, W, 3) RGB and their `labels` (H, W): the earlier and the later one, taken as of the same hours."""
    memory = SmokeMemory()
    memory.look(photos[0], labels[0], 0.0)
    found = memory.look(photos[1], labels[1], APART_S)
    drawn = np.zeros(labels[1].shape, np.uint8)
    for polygon in pair.smoke:
        cv2.fillPoly(drawn, [np.rint(np.array(polygon)).astype(np.int32)], [1])
    smoke, land = drawn > 0, (labels[1] != Label.SKY) & (labels[1] != UNLABELLED)
    told = np.zeros_like(land) if found is None else found & land
    return SmokeScore(
        int(smoke.sum()), int((smoke & land).sum()), int((smoke & told).sum()),
        int((land & ~smoke).sum()), int((told & ~smoke).sum()),
    )  # fmt: skip
