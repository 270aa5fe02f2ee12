"""What the classes of a label image mean to depth: where the ground shows, and how high what grows there stands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ltm_core.errors import ConfigError
from ltm_core.types import BoolArray, Float32Array
from ltm_core.vision.labels import UNLABELLED, Label, LabelSet

COVER_HEIGHTS: Mapping[str, float] = {"grass": 0.2, "shrub": 1.0, "tree": 6.0}
"""Metres by which the visible surface of a class stands above the bare ground, as far as a camera at a slant sees it:
somewhat below the plants' own height, since it also looks between them. Priors, for want of a canopy raster."""
GROUND_CLASSES = ("grass", "bare", "water", "shrub")
"""Whose depth is that of the terrain but for their cover height: what a network may be fitted to."""
CREST = 3.0
"""Metres that unlabelled or low cover may rise over a crest."""
TREE_CREST = 12.0
"""Metres that a tree may rise over a crest."""
STANDING: Mapping[str, float] = {"grass": -3.2, "shrub": 0.2, "tree": 2.7, "bare": -3.2, "water": -3.2, "built": 2.7}
"""Log odds that a pixel shows something which stands before the ground behind it, where all labels about it are of a
class; see `occlusion_prior`."""
UNLABELLED_STANDING = 0.1
"""The same of unlabelled pixels."""

CANOPY: Mapping[str, float] = {"grass": -1.5, "shrub": 1.1, "tree": 1.6, "bare": -2.6, "water": -3.0, "built": 1.6}
"""Log odds that a canopy raster, and not bare ground, is what a pixel of a class shows where the two differ."""

OUTLINE: Mapping[str, float] = {"grass": -0.9, "shrub": 0.6, "tree": 1.3, "bare": -1.7, "water": -1.7, "built": 1.3}
"""Log odds that a pixel a metre above a crest, which the photo's colours give to the crest, belongs to it, by class."""
UNLABELLED_OUTLINE = 0.4
"""The same of unlabelled pixels."""


@dataclass(frozen=True, eq=False)
class ClassPriors:
    """Tables over the 256 ids of a label image.

    `cover`: float32 metres of cover above bare ground. `ground`: bool, the terrain shows there. `crest`: float32 metres
    to which a silhouette may be raised there. `canopy_log_odds`: float32 log odds that a canopy raster and not bare
    ground is what shows, see CANOPY. `occluder_log_odds`: float32 log odds that something stands before the ground,
    see STANDING. `outline`: float32 log odds that a pixel belongs to a crest, see OUTLINE. `sky`: the id of sky.
    """

    cover: Float32Array
    ground: BoolArray
    crest: Float32Array
    canopy_log_odds: Float32Array
    occluder_log_odds: Float32Array
    outline: Float32Array
    sky: int = int(Label.SKY)

    @classmethod
    def of(cls, labels: LabelSet, heights: Mapping[str, float] = COVER_HEIGHTS) -> ClassPriors:
        """The tables of a label set. Raises ConfigError for the height of a class that is none, or below 0."""
        cover, ground = np.zeros(256, np.float32), np.zeros(256, np.bool_)
        crest, surface = np.full(256, CREST, np.float32), np.zeros(256, np.float32)
        for name, height in heights.items():
            if not 0 <= height < 100:
                raise ConfigError(f"cover height of {name} is {height} m; give metres of 0 to 100")
            cover[labels.id_of(name)] = height
        ground[[labels.id_of(name) for name in GROUND_CLASSES]] = True
        crest[Label.TREE] = TREE_CREST
        crest[[Label.BARE, Label.WATER]] = 1.0
        for name, odds in CANOPY.items():
            surface[labels.id_of(name)] = odds
        crest[Label.SKY] = 0.0
        standing = np.full(256, UNLABELLED_STANDING, np.float32)
        for name, odds in STANDING.items():
            standing[labels.id_of(name)] = odds
        outline = np.full(256, UNLABELLED_OUTLINE, np.float32)
        outline[Label.SKY] = 0.0
        for name, log_odds in OUTLINE.items():
            outline[labels.id_of(name)] = log_odds
        cover[UNLABELLED] = 0.0
        ground[UNLABELLED] = True
        return cls(cover, ground, crest, surface, standing, outline)
