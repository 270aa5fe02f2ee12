"""Typed configuration of the photos to train on or hold out, with a person's tags of the cover of far slopes."""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import UInt8Array
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_lab.training.labelled_frames import LAND
from ltm_lab.training.teachers import TAG_LABELS

_BOX_LABELS = {label.name.lower(): int(label) for label in Label} | {"land": LAND}


class PhotoSets(StrictModel):
    """`photos`: file name without ending -> tag of its slopes (see `teachers`); photos not named are not used.
    `held_out`: set -> photos of it; the others are in `train`. `boxes`: photo -> areas whose class a person gives:
    (class, left, top, right, bottom), in percent of the photo's sides; `land`: ground, not told what grows there."""

    size: tuple[int, int]  # width, height in pixels that photos are brought to
    train: str = "photos"
    held_out: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    photos: dict[str, str] = Field(min_length=1)
    boxes: dict[str, tuple[tuple[str, float, float, float, float], ...]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _names_and_tags_are_known(self) -> PhotoSets:
        wrong = sorted(name for name, tag in self.photos.items() if len(tag) != 2 or set(tag) - set(TAG_LABELS))
        if wrong:
            raise ValueError(f"photos: tags of {', '.join(wrong)} are not two of {', '.join(TAG_LABELS)}")
        named = [name for names in self.held_out.values() for name in names]
        unknown = sorted(set(named) - set(self.photos))
        if unknown or len(set(named)) != len(named):
            raise ValueError(f"held_out: each photo once, and among photos; unknown: {', '.join(unknown) or 'none'}")
        for name, boxes in self.boxes.items():
            for label, left, top, right, bottom in boxes:
                inside = 0 <= left < right <= 100 and 0 <= top < bottom <= 100
                if name not in self.photos or label not in _BOX_LABELS or not inside:
                    raise ValueError(
                        f"boxes: {name}: {label} {left}, {top}, {right}, {bottom}: expected one of photos, a class and "
                        "left < right, top < bottom in percent"
                    )
        return self

    def by_hand(self, name: str) -> UInt8Array:
        """What a person says of a photo's pixels, (height, width) uint8; 255 where nothing."""
        width, height = self.size
        labels = np.full((height, width), UNLABELLED, np.uint8)
        for label, left, top, right, bottom in self.boxes.get(name, ()):
            rows = slice(round(top * height / 100), round(bottom * height / 100))
            labels[rows, round(left * width / 100) : round(right * width / 100)] = _BOX_LABELS[label]
        return labels

    def set_of(self, name: str) -> str:
        """The set that a photo is in."""
        return next((part for part, names in self.held_out.items() if name in names), self.train)
