"""Select pixels where the terrain can be trusted, by what label classes mean to depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numba
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
    of the ground. `outline`: log odds that a pixel belongs to a crest. `sky`: the id of sky.
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
        # The sky says nothing of a canopy or of a crest; of what stands before the ground it is not asked.
        outline = _table(labels, config.boundaries.outline)
        outline[Label.SKY] = 0.0
        canopy = _table(labels, config.decision.canopy)
        canopy[Label.SKY] = 0.0
        return cls(cover, ground, crest, canopy, _table(labels, config.occlusion.standing), outline)


class LabelView(NamedTuple):
    """Compiled form of a label image: ids (H, W), whether there are any, and the id of sky."""

    ids: UInt8Array
    known: bool
    sky: int

    @classmethod
    def of(cls, labels: UInt8Array | None, classes: ClassPriors) -> LabelView:
        """Return the view of `labels`, (H, W) class ids or None."""
        return cls(np.zeros((1, 1), np.uint8) if labels is None else labels, labels is not None, classes.sky)


def _table(labels: LabelSet, odds: ClassLogOdds) -> Float32Array:
    table = np.full(256, odds.unlabelled, np.float32)
    for name, value in odds.model_dump(exclude={"unlabelled"}).items():
        table[labels.id_of(name)] = value
    return table


class _SamplingRules(NamedTuple):
    """As compiled code takes them. `steep`: relative change of depth over two rows that is grazed."""

    jump: np.float32
    unsure: np.float32
    steep: np.float32
    step: int
    clear: int


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

    def part(self, chosen: BoolArray) -> GroundSamples:
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
    rows, cols, depth = _candidates(
        surface,
        sigma,
        np.zeros((1, 1), np.uint8) if labels is None else labels,
        labels is not None,
        ground,
        _SamplingRules(
            np.float32(config.surface.jump),
            np.float32(rules.unsure),
            np.float32(2.0 / (focal * np.tan(np.radians(rules.grazing_deg)))),
            rules.step,
            rules.clear,
        ),
    )
    chosen = _even(depth, rules)
    rows, cols = rows[chosen], cols[chosen]
    return GroundSamples(rows, cols, depth[chosen].astype(np.float64), sigma[rows, cols].astype(np.float64))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _candidates(
    surface: Float32Array,
    sigma: Float32Array,
    labels: UInt8Array,
    labelled: bool,
    ground: BoolArray,
    rules: _SamplingRules,
) -> tuple[IndexArray, IndexArray, Float32Array]:
    """Return the rows, columns and depth of the pixels of a grid that are fit."""
    height, width = surface.shape
    clear, step = rules.clear, rules.step
    down, across = (height - 2 * clear + step - 1) // step, (width - 2 * clear + step - 1) // step
    count = max(down, 0) * max(across, 0)
    rows, cols, depth = np.empty(count, np.intp), np.empty(count, np.intp), np.empty(count, np.float32)
    far, jump, unsure, steep = np.float32(1e9), rules.jump, rules.unsure, rules.steep
    i = 0
    for v in range(clear, height - clear, step):
        for u in range(clear, width - clear, step):
            d = surface[v, u]
            good = d < far and d > 0 and sigma[v, u] < unsure * d and (not labelled or ground[labels[v, u]])
            if good:
                for beside in (
                    surface[v + clear, u],
                    surface[v - clear, u],
                    surface[v, u - clear],
                    surface[v, u + clear],
                ):
                    good &= beside < jump * d and d < jump * beside
                # The rise of the depth in a pixel's angle is the cotangent of the angle between ray and ground.
                good &= abs(surface[v - 1, u] - surface[v + 1, u]) < steep * d
            if good:
                rows[i], cols[i], depth[i] = v, u, d
                i += 1
    return rows[:i], cols[:i], depth[:i]


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
    return np.asarray(_evenly(octave, np.minimum(1.0, most / np.maximum(counts, 1))))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _evenly(kind: IndexArray, share: Float64Array) -> IndexArray:
    """Return which to keep of things (N,) of several kinds, that `share` of each kind: evenly spread, since they come
    row by row."""
    chosen, rank, n = np.empty(len(kind), np.intp), np.zeros(len(share), np.intp), 0
    for i in range(len(kind)):
        k = kind[i]
        before = np.floor(rank[k] * share[k])
        rank[k] += 1
        if np.floor(rank[k] * share[k]) > before:
            chosen[n] = i
            n += 1
    return chosen[:n]
