"""Measure depth by the network alone, in rows of pixels, to test whether the terrain has changed.

Rows of pixels, whole: the terrain beside what a network sees, and their mean where both agree.

What nearly all pixels need is computed in short loops without branches, which compilers turn into vector code.

What a network alone measures, for whoever asks whether the terrain is still what it was.

Fused depth holds the terrain's word: it takes one side where the two disagree, and is drawn to it where they do not. A
map of what has changed must be told what was seen, and how surely, without it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Int32Array, UInt8Array
from ltm_core.depth.error_model import ErrorTables, expected_predictions, invert
from ltm_core.depth.fusion_config import DecisionConfig, FusionConfig
from ltm_core.depth.pixel_fusion import elsewhere
from ltm_core.depth.scale_fit import ScaleFit

OWN = 4.0
"""Times a network's own variance up to which a joint variance is bounded beforehand (`DecisionRules.widest`)."""


class DecisionRules(NamedTuple):
    """`DecisionConfig` as compiled code takes it."""

    disagree: np.float32
    agree: np.float32
    torn: np.float32
    soft: np.float32
    likelihood_weight: np.float32
    canopy_weight: np.float32
    open: np.float32
    elsewhere: np.float32
    between: np.float32
    blurred: np.float32
    ranges: np.float32
    sure: np.float32
    """1 - open."""
    few: np.float32
    """Log odds of `open`."""
    per_likelihood_weight: np.float32
    widest: np.float32
    """Log of the greatest that a likelihood against what stands nearer can be for its exponential."""

    @classmethod
    def of(cls, config: DecisionConfig) -> DecisionRules:
        given = (np.float32(getattr(config, name)) for name in cls._fields[:11])
        few = math.log(config.open / (1.0 - config.open))
        widest = math.log(config.ranges / math.sqrt(2.0 * math.pi * OWN))
        more = (np.float32(value) for value in (1.0 - config.open, few, 1.0 / config.likelihood_weight, widest))
        return cls(*given, *more)


class FusionRow(NamedTuple):
    """One row of a photo, (W,) each, while it is fused.

    `depth`, `sigma`: in as the terrain's, out as fused; `source`: `topodepth.Source`; `labels`: class ids. `seen`,
    `nearest`, `farthest`: inverse depth, 1/m, that the network sees, and its neighbours' extremes. `true`: the
    terrain's inverse depth, 0 for sky and unknown ground, `own` its sigma; `spread` the network's; `less`: by how much
    less than `true` it would say; `off`: by how much nearer it sees than it would say, with the variance `joint`.
    `part`: to work in. `asked`: whether the two disagree or the terrain is unknown. `column`: of the error tables.
    """

    depth: Float32Array
    sigma: Float32Array
    source: UInt8Array
    labels: UInt8Array
    seen: Float32Array
    nearest: Float32Array
    farthest: Float32Array
    true: Float32Array
    own: Float32Array
    less: Float32Array
    spread: Float32Array
    off: Float32Array
    joint: Float32Array
    part: Float32Array
    place: Int32Array
    column: Int32Array
    asked: BoolArray


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def compare_row(row: FusionRow, tables: Float32Array, sky: int, rules: DecisionRules) -> int:
    """Hold one row of terrain against what the network sees: fills `true` to `asked`; how many are asked.

    `tables`: (C * D, 4) the row's of `interpolation_table`. Compilers give up on loops that write into several of many
    arrays: one result a loop.
    """
    d, s, y, label = row.depth, row.sigma, row.seen, row.labels
    true, own, less, spread, off, joint = row.true, row.own, row.less, row.spread, row.off, row.joint
    near, back, asked, soft_share, disagree = row.nearest, row.farthest, row.asked, rules.soft, rules.disagree
    width, far, one, none = len(d), np.float32(1e9), np.float32(1.0), np.float32(0.0)
    for u in range(width):
        true[u] = one / d[u] if d[u] < far else none
    for u in range(width):
        b = s[u] * true[u] * true[u]
        own[u] = b if d[u] < far else none
    expected_predictions(true, tables, row.column, row.place, row.part, less, spread)
    for u in range(width):
        off[u] = y[u] - true[u] + less[u]
    for u in range(width):
        # Between its neighbours a pixel of the network is as unsure as they differ, on slopes and at edges.
        soft = soft_share * (near[u] - back[u])
        joint[u] = spread[u] * spread[u] + own[u] * own[u] + soft * soft
    count = 0
    for u in range(width):
        odd = (off[u] * off[u] > disagree * joint[u]) & ((off[u] > 0) | (d[u] < far))
        ask = (label[u] != sky) & (odd | ((d[u] != d[u]) & (y[u] == y[u])))
        asked[u] = ask
        count += ask
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def average_row(row: FusionRow, rules: DecisionRules) -> None:
    """Mean by inverse variance, in inverse depth, where both agree within so many sigmas and the terrain is one
    surface; see `compare_row`."""
    d, s, kind = row.depth, row.sigma, row.source
    true, own, off, joint, weight = row.true, row.own, row.off, row.joint, row.part
    agree, torn = rules.agree, rules.torn
    width, one = len(d), np.float32(1.0)
    for u in range(width):
        w = own[u] * own[u] / joint[u]
        fits = (off[u] * off[u] <= agree * joint[u]) & (true[u] + w * off[u] > np.float32(0.5) * true[u])
        weight[u] = w if fits & (own[u] > 0) & (own[u] < torn * true[u]) else np.float32(-1.0)
    for u in range(width):
        d[u] = one / (true[u] + weight[u] * off[u]) if weight[u] >= 0 else d[u]
    for u in range(width):
        s[u] = own[u] * np.sqrt(one - weight[u]) * d[u] * d[u] if weight[u] >= 0 else s[u]
    for u in range(width):
        kind[u] = 3 if weight[u] > np.float32(0.1) else kind[u]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def begin_row(d: Float32Array, s: Float32Array, kind: UInt8Array) -> None:
    """What a row is without a network."""
    far, none = np.float32(1e9), np.float32(np.nan)
    for u in range(len(d)):
        kind[u] = 1 if d[u] < far else (4 if d[u] > far else 0)
    for u in range(len(d)):
        s[u] = s[u] if d[u] < far else none


@dataclass(frozen=True, eq=False)
class NetworkMeasurement:
    """`depth`, `sigma`: (h, w) float32 metres along the optical axis, at the network's own size, edge to edge over the
    photo; NaN where nothing is measured."""

    depth: Float32Array
    sigma: Float32Array

    @classmethod
    def of(cls, fit: ScaleFit, config: FusionConfig) -> NetworkMeasurement:
        """From a fit that can be used. What is seen may not be the ground on which the network was fitted, so sigma is
        that of what stands before it."""
        depth, sigma = np.empty_like(fit.inverse), np.empty_like(fit.inverse)
        seen, sure = (fit.inverse, fit.nearest, fit.farthest), np.float32(config.decision.measured)
        _measure(seen, fit.error_model.tables, DecisionRules.of(config.decision), sure, depth, sigma)
        return cls(depth, sigma)

    def without(self, hidden: BoolArray) -> NetworkMeasurement:
        """Nothing measured in pixels (h, w) that show something else than the terrain."""
        nothing = np.float32(np.nan)
        return NetworkMeasurement(np.where(hidden, nothing, self.depth), np.where(hidden, nothing, self.sigma))

    @classmethod
    def none(cls) -> NetworkMeasurement:
        """Of a photo that no network measures."""
        nothing = np.full((1, 1), np.nan, np.float32)
        return cls(nothing, nothing)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _measure(
    seen: tuple[Float32Array, Float32Array, Float32Array],
    errors: ErrorTables,
    rules: DecisionRules,
    sure: np.float32,
    depth: Float32Array,
    sigma: Float32Array,
) -> None:
    """`seen`: (h, w) each, what the network sees, and the greatest and least among neighbours; `sure`: relative sigma
    from which on a depth measures nothing."""
    inverse, nearest, farthest = seen
    height, width = inverse.shape
    one, none = np.float32(1.0), np.float32(np.nan)
    for v in range(height):
        row = v * errors.shift.shape[0] // height
        for u in range(width):
            depth[v, u], sigma[v, u] = none, none
            if inverse[v, u] > 0:
                true, t = invert(row, u * errors.shift.shape[1] // width, inverse[v, u], errors)
                t = elsewhere(t, nearest[v, u], farthest[v, u], rules)
                if t < sure * true:
                    depth[v, u], sigma[v, u] = one / true, t / (true * true)
