"""Decide between terrain and network pixel by pixel, in whole rows.

Where the network says what it would say if the terrain were right (`error_model`), both are averaged by inverse
variance, in inverse depth. Where it sees something nearer, the odds of an object (`occlusion_prior`) against an error
of the network decide; if they are nearly even, depth is the mean of both, and sigma includes their distance."""

from typing import NamedTuple

import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.depth.error_model import ErrorModel, expected_prediction, invert
from ltm_core.depth.fusion_config import DecisionConfig, FusionConfig
from ltm_core.depth.ground_sampling import ClassPriors, LabelView
from ltm_core.depth.guided_upsampling import NetworkView, upsample_row
from ltm_core.depth.occlusion_prior import OcclusionPrior, mixture_moments, occlusion_log_odds


class DecisionRules(NamedTuple):
    """Compiled form of `DecisionConfig`."""

    disagree: np.float32
    agree: np.float32
    torn: np.float32
    soft: np.float32
    likelihood_weight: np.float32
    canopy_weight: np.float32
    open: np.float32
    elsewhere: np.float32
    between: np.float32
    ranges: np.float32
    sure: np.float32
    """The value 1 - open."""

    @classmethod
    def of(cls, config: DecisionConfig) -> "DecisionRules":
        given = [np.float32(getattr(config, name)) for name in cls._fields[:10]]
        return cls(*given, *[np.float32(1.0 - config.open)])


class FusionRow(NamedTuple):
    """One row of a photo, (W,) each, while it is fused.

    `depth`, `sigma`: in as the terrain's, out as fused; `source`: `topodepth.DepthSource`; `labels`: class ids. `seen`,
    `nearest`, `farthest`: inverse depth, 1/m, that the network sees, and its neighbours' extremes. `true`: the
    terrain's inverse depth, 0 for sky and unknown ground, `own` its sigma; `spread` the network's; `off`: by how much
    nearer it sees than it would say of the terrain, with the variance `joint`; `part`: the network's weight. `asked`:
    whether the two disagree or the terrain is unknown."""

    depth: Float32Array
    sigma: Float32Array
    source: UInt8Array
    labels: UInt8Array
    seen: Float32Array
    nearest: Float32Array
    farthest: Float32Array
    true: Float32Array
    own: Float32Array
    spread: Float32Array
    off: Float32Array
    joint: Float32Array
    part: Float32Array
    asked: BoolArray


@helper(fastmath={"nsz", "arcp", "contract"})
def compare_row(row: FusionRow, errors: ErrorModel, sky: int, rules: DecisionRules) -> int:
    """Compare one row of terrain with the network's view: fills `true` to `asked`; returns how many are asked.
    One result a loop, so that compilers vectorise most of them."""
    d, s, y, label = row.depth, row.sigma, row.seen, row.labels
    true, own, spread, off, joint = row.true, row.own, row.spread, row.off, row.joint
    near, back, asked, soft_share, disagree = row.nearest, row.farthest, row.asked, rules.soft, rules.disagree
    width, far, one, none = len(d), np.float32(1e9), np.float32(1.0), np.float32(0.0)
    for u in range(width):
        true[u] = one / d[u] if d[u] < far else none
    for u in range(width):
        b = s[u] * true[u] * true[u]
        own[u] = b if d[u] < far else none
    for u in range(width):
        less, spread[u] = expected_prediction(true[u], errors)
        off[u] = y[u] - true[u] + less
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


@helper(fastmath={"nsz", "arcp", "contract"})
def average_row(row: FusionRow, rules: DecisionRules) -> None:
    """Average both depths by inverse variance, in inverse depth, where they agree and the terrain is one surface; see
    `compare_row`."""
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


@helper(fastmath={"nsz", "arcp", "contract"})
def begin_row(d: Float32Array, s: Float32Array, kind: UInt8Array) -> None:
    """Initialise a row without a network."""
    far, none = np.float32(1e9), np.float32(np.nan)
    for u in range(len(d)):
        kind[u] = 1 if d[u] < far else (4 if d[u] > far else 0)
    for u in range(len(d)):
        s[u] = s[u] if d[u] < far else none


def fuse_pixels(
    depth: Float32Array,
    sigma: Float32Array,
    over: Float32Array | None,
    network: NetworkView | None,
    standing: OcclusionPrior | None,
    labels: UInt8Array | None,
    classes: ClassPriors,
    source: UInt8Array,
    config: FusionConfig,
) -> None:
    """Fuse in place: `depth` and `sigma` (H, W) are the terrain's on input and the fused ones on output; `source` is a
    `topodepth.DepthSource`. `over`: (H, W) depth of a canopy raster; `network`, `standing`, `labels` (H, W) or None."""
    over = np.zeros((0, 0), np.float32) if over is None else over
    view, prior = network or NetworkView.none(), standing or OcclusionPrior.none()
    choice = classes.canopy_log_odds, LabelView.of(labels, classes), DecisionRules.of(config.decision)
    _fuse(depth, sigma, source, over, view, prior, *choice)


@kernel(nogil=True, fastmath={"nsz", "arcp", "contract"})
def _fuse(
    depth: Float32Array,
    sigma: Float32Array,
    source: UInt8Array,
    over: Float32Array,
    view: NetworkView,
    prior: OcclusionPrior,
    prefers_over: Float32Array,
    labels: LabelView,
    rules: DecisionRules,
) -> None:
    """Fuse row by row: only the pixels where terrain and network disagree are examined one by one."""
    half, one, far = np.float32(0.5), np.float32(1.0), np.float32(1e9)
    height, width = depth.shape
    errors, gross, odds, feet = view.errors, view.gross, prior.odds, prior.feet
    between, work = np.empty((4, view.cells.shape[2]), np.float32), np.empty((9, width), np.float32)
    y, near, back = work[0], work[1], work[2]
    true, own, spread, off, joint, part = work[3], work[4], work[5], work[6], work[7], work[8]
    cell, asked = np.empty(width, np.int32), np.zeros(width, np.bool_)
    unlabelled = np.full(width, np.uint8(255))
    for u in range(width):
        cell[u] = u * odds.shape[1] // width
    for v in range(height - 1, -1, -1):
        d, s, kind = depth[v], sigma[v], source[v]
        label = labels.ids[v] if labels.known else unlabelled
        row = FusionRow(d, s, kind, label, y, near, back, true, own, spread, off, joint, part, asked)
        at = odds[v * odds.shape[0] // height]
        if view.there:
            upsample_row(view, v, between, work)
        if len(over):
            _choose(row, over[v], prefers_over, view, rules)
        begin_row(d, s, kind)
        if not view.there:
            continue
        count = compare_row(row, errors, labels.sky, rules)
        average_row(row, rules)
        if not count:
            continue
        for u in range(width):
            if not asked[u]:
                continue
            other, likely = y[u], one
            nearer = kind[u] > 0 and off[u] > 0
            if kind[u] > 0 and not nearer:
                continue  # ground seldom vanishes: what is seen farther than it is the network's error
            if nearer:
                # Something stands there? At a soft edge only where the network is nearer to the near side; away from
                # edges what neighbours see is but their own place.
                known = at[cell[u]]
                edge = (near[u] - y[u]) / off[u]
                if not edge < one:
                    continue
                known = occlusion_log_odds(prior, known, other, feet[cell[u]], v)
                # Errors extend over many pixels, so the log likelihood is weighted.
                against = log_against(other, off[u], joint[u], spread[u], gross, rules)
                likely = np.float32(one / (one + np.exp(rules.likelihood_weight * against - known)))
            if not (likely >= rules.open and other > 0):
                continue
            # An int32: `network_measurement` has a compiled form of its own, without this kernel's fastmath.
            inverse, t = invert(other, errors)
            if nearer:
                # The shifts were learned on ground; an object in front of it has the depth of the line alone, and its
                # presence is known even if its depth is not.
                t, inverse = min(t * other / inverse, np.float32(0.99) * other), other
            if not (t < inverse and (kind[u] == 0 or inverse > true[u])):
                continue
            t = elsewhere(t, near[u], back[u], rules)
            t /= inverse * inverse
            if d[u] < far and likely < rules.sure:
                d[u], s[u] = mixture_moments(d[u], s[u], one / inverse, t, likely)
            elif likely > half:
                d[u], s[u] = one / inverse, t
            kind[u] = 2 if likely > half else kind[u]


@kernel(nogil=True)
def elsewhere(t: np.float32, near: np.float32, back: np.float32, rules: DecisionRules) -> np.float32:
    """Return a network's sigma, 1/m, for objects in front of the ground, where `t` is its own; which of the neighbours'
    depths from `back` to `near` a pixel has is uncertain."""
    between = rules.between * (near - back)
    return np.float32(np.sqrt(rules.elsewhere * t * t + between * between))


@helper()
def log_against(
    other: np.float32, off: np.float32, joint: np.float32, spread: np.float32, gross: np.float32, rules: DecisionRules
) -> np.float32:
    """Return the log likelihood ratio of the terrain against an object anywhere in front of it at the inverse depth
    `other`, 1/m. `off`: excess over the expected value, with variance `joint`, of its own `spread`. `gross`: share of
    gross errors."""
    fits = np.exp(np.float32(-0.5) * off * off / joint) / np.sqrt(np.float32(2 * np.pi) * joint)
    return np.float32(np.log((np.float32(1.0) - gross) * fits * rules.ranges * max(other, spread) + gross))


@helper()
def _choose(
    row: FusionRow, over: Float32Array, prefers_over: Float32Array, view: NetworkView, rules: DecisionRules
) -> None:
    """Bare ground or canopy, in one row: the label's odds, and which of the two the network is nearer to."""
    far, one, half = np.float32(1e9), np.float32(1.0), np.float32(0.5)
    depth, sigma, seen, labels, errors = row.depth, row.sigma, row.seen, row.labels, view.errors
    for u in range(len(depth)):
        c, d, s = over[u], depth[u], sigma[u]
        if c < far and (not d < far or abs(c - d) > s):
            odds = prefers_over[labels[u]]
            if view.there and seen[u] == seen[u]:
                y, a = seen[u], np.float32(0.0)
                if d < far:
                    a = one / d
                m, t = expected_prediction(a, errors)
                to_ground = (y - a + m) / t
                for_over = half * to_ground * to_ground + np.log(t)
                m, t = expected_prediction(one / c, errors)
                to_over = (y - one / c + m) / t
                for_over -= half * to_over * to_over + np.log(t)
                odds += rules.canopy_weight * for_over
            likely = one / (one + np.exp(-odds))
            top = np.float32(0.03) * c if np.isnan(s) else max(s, np.float32(0.01) * c)
            if d < far and min(likely, one - likely) > rules.open:
                depth[u], sigma[u] = mixture_moments(d, s, c, top, likely)
            elif odds > 0:
                depth[u], sigma[u] = c, top
