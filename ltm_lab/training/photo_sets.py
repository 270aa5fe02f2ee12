"""Which photos to train on or to hold out, and their labels, from teacher networks and from a person's tags.

A general scene network calls any far slope `mountain`, whatever grows there. What such a slope carries comes from a
tag of two letters that a person gives a photo: the cover of the slope's bright part and of its dark part (snow over
forest: `BT`; a meadow with shrubs: `GS`), `-` where they could not tell. Otherwise the slope is LAND: some cover, but
neither sky nor water nor built.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from pydantic import Field, model_validator

from ltm_core.base.errors import ConfigError
from ltm_core.base.strict_model import StrictModel
from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.label_heads.labelled_frames import LAND, UNKNOWN
from ltm_core.vision.labels import UNLABELLED, Label

TAG_LABELS = {"G": Label.GRASS, "S": Label.SHRUB, "T": Label.TREE, "B": Label.BARE, "-": LAND}
_SKY_SURE = 0.25  # probability of sky: below and above 1 - this the sky network is believed
_NEAR_EDGE = 0.02  # of the photo's width: farther from the skyline than this two teachers must agree
_SURE = {Label.GRASS: 0.55, Label.SHRUB: 0.55, Label.TREE: 0.6, Label.BARE: 0.6, Label.WATER: 0.8, Label.BUILT: 0.8}
_DARK_AROUND = 0.04  # of the photo's width: a dark pixel is forest only where most within this is dark
_MARGIN = 0.06  # of full brightness about the threshold between bright and dark: there the tag says nothing
_BOX_LABELS = {label.name.lower(): int(label) for label in Label} | {"land": LAND}


class PhotoSets(StrictModel):
    """`photos`: file name without ending -> tag of its slopes (see `teach`); photos not named are not used.
    `held_out`: set -> photos of it; the others are in `train`. `boxes`: photo -> areas whose class a person gives:
    (class, left, top, right, bottom), in percent of the photo's sides; `land`: ground, not told what grows there."""

    size: tuple[int, int]  # width, height in pixels that photos are brought to
    train: str = "photos"
    held_out: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    photos: dict[str, str] = Field(min_length=1)
    boxes: dict[str, tuple[tuple[str, float, float, float, float], ...]] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _names_and_tags_are_known(self) -> "PhotoSets":
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


@dataclass(frozen=True)
class Opinions:
    """What teachers say of each pixel of a photo, all (H, W) float32 in 0..1: `sky` of the sky network; of the scene
    network its own sky, `slope` (mountain) and `classes`, the probability of each of our labels that it knows."""

    sky: Float32Array
    scene_sky: Float32Array
    slope: Float32Array
    classes: dict[Label, Float32Array]


def teach(image: UInt8Array, opinions: Opinions, tag: str = "--") -> UInt8Array:
    """Labels (H, W) to train on, of a photo (H, W, 3) uint8 RGB. Raises ConfigError for a tag of other letters."""
    if len(tag) != 2 or set(tag) - set(TAG_LABELS):
        raise ConfigError(f"tag {tag!r}: expected two of {', '.join(TAG_LABELS)}, of the slope's bright and dark part")
    labels = np.full(image.shape[:2], UNLABELLED, np.uint8)
    ground = np.maximum(1.0 - opinions.scene_sky, 1e-3)
    for label, probability in opinions.classes.items():
        labels[probability / ground > _SURE[label]] = label
    slope = opinions.slope / ground > 0.5
    labels[slope] = _slope_cover(image, slope & (opinions.sky < 0.5), tag)[slope]
    labels[opinions.sky >= 0.5] = Label.SKY
    labels[(opinions.sky > _SKY_SURE) & (opinions.sky < 1.0 - _SKY_SURE)] = UNKNOWN
    labels[_disputed(opinions)] = UNKNOWN
    return labels


def _slope_cover(image: UInt8Array, slope: BoolArray, tag: str) -> UInt8Array:
    """Bright and dark parts of the slope, split by Otsu's threshold of its own brightness."""
    bright_label, dark_label = (TAG_LABELS[letter] for letter in tag)
    if not slope.any() or bright_label == dark_label:
        return np.full(slope.shape, bright_label, np.uint8)
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), (0, 0), 1.0)
    threshold, _ = cv2.threshold(grey[slope][:, None], 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    offset = (grey.astype(np.float32) - threshold) / 255.0
    size = max(3, 2 * round(_DARK_AROUND * slope.shape[1]) + 1)
    area = np.maximum(cv2.blur(slope.astype(np.float32), (size, size)), 1e-6)
    dark_around = cv2.blur((slope & (offset < 0)).astype(np.float32), (size, size)) / area
    cover = np.full(slope.shape, LAND, np.uint8)
    cover[offset > _MARGIN] = bright_label
    cover[(offset < -_MARGIN / 2) & (dark_around > 0.75)] = dark_label
    return cover


def _disputed(opinions: Opinions) -> BoolArray:
    """Pixels away from the skyline of which one teacher says sky and the other is sure that it is not."""
    sky = (opinions.sky >= 0.5).astype(np.uint8)
    size = 2 * max(1, round(_NEAR_EDGE * sky.shape[1])) + 1
    kernel = np.ones((size, size), np.uint8)
    away = cv2.dilate(sky, kernel) == cv2.erode(sky, kernel)
    ground_says_scene, sky_says_scene = opinions.scene_sky < 0.1, opinions.scene_sky > 0.9
    return np.asarray(away & (((sky == 1) & ground_says_scene) | ((sky == 0) & sky_says_scene)))
