"""Rows of pixels, whole: the terrain beside what a network sees, and their mean where both agree.

What nearly all pixels need is computed in short loops without branches, which compilers turn into vector code.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from ltm_core.depth.error_model import expected_predictions
from ltm_core.depth.fusion_config import DecisionConfig
from ltm_core.types import BoolArray, Float32Array, Int32Array, UInt8Array

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
