"""Which photos are trained on, which are held out, and what a person says of their slopes."""

from __future__ import annotations

from pydantic import Field, model_validator

from ltm_core.vision.strict import StrictModel
from ltm_core.vision.train.teachers import TAG_LABELS


class PhotoSets(StrictModel):
    """`photos`: file name without ending -> tag of its slopes (see `teachers`); photos not named are not used.
    `held_out`: set -> photos of it; the others are in `train`."""

    size: tuple[int, int]  # width, height in pixels that photos are brought to
    train: str = "photos"
    held_out: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    photos: dict[str, str] = Field(min_length=1)

    @model_validator(mode="after")
    def _names_and_tags_are_known(self) -> PhotoSets:
        wrong = sorted(name for name, tag in self.photos.items() if len(tag) != 2 or set(tag) - set(TAG_LABELS))
        if wrong:
            raise ValueError(f"photos: tags of {', '.join(wrong)} are not two of {', '.join(TAG_LABELS)}")
        named = [name for names in self.held_out.values() for name in names]
        unknown = sorted(set(named) - set(self.photos))
        if unknown or len(set(named)) != len(named):
            raise ValueError(f"held_out: each photo once, and among photos; unknown: {', '.join(unknown) or 'none'}")
        return self

    def set_of(self, name: str) -> str:
        """The set that a photo is in."""
        return next((part for part, names in self.held_out.items() if name in names), self.train)
