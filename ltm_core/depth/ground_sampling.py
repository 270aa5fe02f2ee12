"""Select pixels where the terrain can be trusted, by what label classes mean to depth."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Float64Array, IndexArray, UInt8Array
from ltm_core.depth.fusion_config import ClassLogOdds, FusionConfig, SamplingConfig
from ltm_core.vision.labels import UNLABELLED, Label, LabelSet

GROUND_CLASSES = ("grass", "bare", "water", "shrub")
"""Classes whose depth is that of the terrain plus their cover height; networks are fitted to them."""
VEGETATION = ("grass", "shrub", "tree")


@dataclass(frozen=True, eq=False)
class ClassPriors:
    """Tables over the 256 ids of a label image; for their values see `fusion_config`.

    `cover`: metres of cover above bare ground. `ground`: whether the terrain shows. `crest`: metres to which an edge
    may be raised. `canopy_log_odds`: of a canopy raster against bare ground. `occluder_log_odds`: of something in front
    of the ground. `sky`: the id of sky."""

    cover: Float32Array
    ground: BoolArray
    crest: Float32Array
    canopy_log_odds: Float32Array
    occluder_log_odds: Float32Array
    sky: int = int(Label.SKY)

    @classmethod
    def of(cls, labels: LabelSet, config: FusionConfig | None = None) -> "ClassPriors":
        """Return the tables of a label set."""
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
        # The sky says nothing of a canopy; of what stands before the ground it is not asked.
        canopy = _table(labels, config.decision.canopy)
        canopy[Label.SKY] = 0.0
        return cls(cover, ground, crest, canopy, _table(labels, config.occlusion.standing))


class LabelView(NamedTuple):
    """Compiled form of a label image: ids (H, W), whether there are any, and the id of sky."""

    ids: UInt8Array
    known: bool
    sky: int

    @classmethod
    def of(cls, labels: UInt8Array | None, classes: ClassPriors) -> "LabelView":
        """Return the view of `labels`, (H, W) class ids or None."""
        return cls(np.zeros((1, 1), np.uint8) if labels is None else labels, labels is not None, classes.sky)


def _table(labels: LabelSet, odds: ClassLogOdds) -> Float32Array:
    table = np.full(256, odds.unlabelled, np.float32)
    for name, value in odds.model_dump(exclude={"unlabelled"}).items():
        table[labels.id_of(name)] = value
    return table


@dataclass(frozen=True, eq=False)
class GroundSamples:
    """Ground samples. `rows`, `cols`: (N,) pixels of the photo; `depth`, `sigma`: (N,) float64 metres of the surface
    there."""

    rows: IndexArray
    cols: IndexArray
    depth: Float64Array
    sigma: Float64Array

    def __len__(self) -> int:
        return len(self.rows)

    def part(self, chosen: BoolArray) -> "GroundSamples":
        """Return the samples selected by `chosen` (N,)."""
        return GroundSamples(self.rows[chosen], self.cols[chosen], self.depth[chosen], self.sigma[chosen])


def ground_samples(
    surface: Float32Array,
    sigma: Float32Array,
    labels: UInt8Array | None,
    ground: BoolArray,
    focal: float,
    config: FusionConfig,
) -> GroundSamples:
    """Return evenly spread pixels of ground classes on terrain, without sky, silhouettes, grazing views and uncertain
    depths. `ground`: (256,) whether a class is ground. `focal`: pixels."""
    rules = config.sampling
    jump, clear = np.float32(config.surface.jump), rules.clear
    steep = np.float32(2.0 / (focal * np.tan(np.radians(rules.grazing_deg))))  # relative change of depth over two rows
    places = np.s_[clear : surface.shape[0] - clear : rules.step, clear : surface.shape[1] - clear : rules.step]
    d = surface[places]
    good = (d < np.float32(1e9)) & (d > 0) & (sigma[places] < np.float32(rules.unsure) * d)
    if labels is not None:
        good &= ground[labels[places]]
    row, col = np.nonzero(good)
    rows, cols, depth = row * rules.step + clear, col * rules.step + clear, d[good]
    good = np.ones(len(depth), np.bool_)
    for down, right in ((clear, 0), (-clear, 0), (0, -clear), (0, clear)):
        beside = surface[rows + down, cols + right]
        good &= (beside < jump * depth) & (depth < jump * beside)
    rows, cols, depth = rows[good], cols[good], depth[good]
    # The rise of the depth in a pixel's angle is the cotangent of the angle between ray and ground.
    with np.errstate(invalid="ignore"):
        good = np.abs(surface[rows - 1, cols] - surface[rows + 1, cols]) < steep * depth
    rows, cols, depth = rows[good], cols[good], depth[good]
    chosen = _even(depth, rules)
    rows, cols = rows[chosen], cols[chosen]
    return GroundSamples(rows, cols, depth[chosen].astype(np.float64), sigma[rows, cols].astype(np.float64))


def _even(depth: Float32Array, rules: SamplingConfig) -> IndexArray:
    """Return which of the samples (N,) to keep, so that what fills most of a photo does not decide for all ranges: no
    class of ranges gets more than `crowd` times the places of a middling one."""
    if not len(depth):
        return np.empty(0, np.intp)
    octave = np.floor(2.0 * np.log2(depth)).astype(np.intp)
    octave -= octave.min()
    counts = np.bincount(octave)
    filled = counts[counts > 0]
    most = rules.crowd * np.median(filled)
    while np.minimum(filled, most).sum() > rules.most:
        most *= 0.9
    share = np.minimum(1.0, most / np.maximum(counts, 1))[octave]
    rank = np.empty(len(depth), np.intp)  # within its octave
    rank[np.argsort(octave, kind="stable")] = np.arange(len(depth)) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.flatnonzero(np.floor((rank + 1) * share) > np.floor(rank * share))
