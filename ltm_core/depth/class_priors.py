"""What the classes of a label image mean to depth: where the ground shows, and how high what grows there stands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.depth.fusion_config import ClassLogOdds, FusionConfig
from ltm_core.vision.labels import UNLABELLED, Label, LabelSet

GROUND_CLASSES = ("grass", "bare", "water", "shrub")
"""Whose depth is that of the terrain but for their cover height: what a network may be fitted to."""
VEGETATION = ("grass", "shrub", "tree")


@dataclass(frozen=True, eq=False)
class ClassPriors:
    """Tables over the 256 ids of a label image; for their values see `fusion_config`.

    `cover`: float32 metres of cover above bare ground. `ground`: bool, the terrain shows there. `crest`: float32 metres
    to which an edge of the terrain may be raised there. `canopy_log_odds`: float32, that a canopy raster and not bare
    ground is what shows. `occluder_log_odds`: float32, that something stands before the ground. `outline`: float32 log
    odds that a pixel belongs to a crest. `sky`: the id of sky.
    """

    cover: Float32Array
    ground: BoolArray
    crest: Float32Array
    canopy_log_odds: Float32Array
    occluder_log_odds: Float32Array
    outline: Float32Array
    sky: int = int(Label.SKY)

    @classmethod
    def of(cls, labels: LabelSet, config: FusionConfig | None = None) -> ClassPriors:
        """The tables of a label set."""
        config = FusionConfig() if config is None else config
        cover, ground = np.zeros(256, np.float32), np.zeros(256, np.bool_)
        for name in VEGETATION:
            cover[labels.id_of(name)] = getattr(config.cover, name)
        ground[[labels.id_of(name) for name in GROUND_CLASSES]] = True
        cover[UNLABELLED], ground[UNLABELLED] = 0.0, True
        crest = np.full(256, config.cover.crest, np.float32)
        crest[Label.TREE] = config.cover.tree_crest
        crest[[Label.BARE, Label.WATER]] = config.cover.bare_crest
        crest[Label.SKY] = 0.0
        # The sky says nothing of a canopy or of a crest; of what stands before the ground it is not asked.
        outline = _table(labels, config.boundaries.outline)
        outline[Label.SKY] = 0.0
        canopy = _table(labels, config.decision.canopy)
        canopy[Label.SKY] = 0.0
        return cls(cover, ground, crest, canopy, _table(labels, config.occlusion.standing), outline)


class LabelView(NamedTuple):
    """A label image as compiled code takes it: ids (H, W), whether there are any, and the id of sky."""

    ids: UInt8Array
    known: bool
    sky: int

    @classmethod
    def of(cls, labels: UInt8Array | None, classes: ClassPriors) -> LabelView:
        """`labels`: (H, W) class ids, or None."""
        return cls(np.zeros((1, 1), np.uint8) if labels is None else labels, labels is not None, classes.sky)


def _table(labels: LabelSet, odds: ClassLogOdds) -> Float32Array:
    table = np.full(256, odds.unlabelled, np.float32)
    for name, value in odds.model_dump(exclude={"unlabelled"}).items():
        table[labels.id_of(name)] = value
    return table
