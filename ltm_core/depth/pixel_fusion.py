"""Terrain or network, pixel by pixel.

If the terrain were right, what would the network say here, and how surely (`error_model`)? Where it says that, both are
averaged by inverse variance, in inverse depth: far away the terrain decides, since a network's sigma grows with the
square of the depth. Where it says something else, either something stands before the terrain, or it is gone, or the
network is wrong; the chance of each, by what the labels about the place say (`occlusion_prior`), decides whether the
network alone is taken. Where that is nearly open, depth is the mean of both as likely as they are, and sigma owns up
to it.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from ltm_core.depth.class_priors import ClassPriors
from ltm_core.depth.error_model import expected_prediction, interpolation_table, invert
from ltm_core.depth.fusion_rows import average_row, begin_row, compare_row
from ltm_core.depth.guided_upsampling import NetworkView, upsample_row
from ltm_core.depth.occlusion_prior import (
    MOST_RATIO,
    NEARER,
    OPEN,
    OcclusionPrior,
    ground_contact,
    mixture_moments,
    occlusion_log_odds,
    snap_to_contact,
)
from ltm_core.types import Float32Array, Int32Array, UInt8Array

_VANISHED = -4.6  # log odds that the ground of a pixel is gone, so that something farther shows
_HEARD = 0.44  # of the log likelihood by which a network speaks for something nearer: its errors go on for many pixels
_HEARD_OVER = 0.18  # the same of that by which it speaks for a canopy raster
_ELSEWHERE = 4.0  # times a network's variance on ground: its variance on what stands before it
_BETWEEN = 0.3  # of the range of a network's depth among neighbours: sigma of which of them a pixel shows
_BLURRED = 0.3  # of a disagreement: what lies between two sides by more is an edge
_OWN = 4.0  # of a network's own variance: up to it `_surely_terrain` can tell
_RANGES = 3.0  # e-foldings of depth over which something that stands before the terrain may be, each as likely
_FEW = math.log(OPEN / (1.0 - OPEN))
_WIDEST = math.log(_RANGES / math.sqrt(2.0 * math.pi * _OWN))


def fuse_pixels(
    depth: Float32Array,
    sigma: Float32Array,
    over: Float32Array | None,
    network: NetworkView | None,
    standing: OcclusionPrior | None,
    labels: UInt8Array | None,
    classes: ClassPriors,
    source: UInt8Array,
) -> None:
    """Fuse in place: `depth` and `sigma` (H, W) come in as the terrain's and go out as the fused ones, `source` as
    `fusion.Source`.

    `over`: (H, W) depth of a canopy raster, `network`: what it sees, `standing`: what may stand there, `labels`: (H, W)
    class ids; None where there is none.
    """
    nothing = np.zeros((1, 1), np.float32)
    standing = OcclusionPrior.none() if standing is None else standing
    seen = NetworkView.none() if network is None else network
    _combine(
        depth,
        sigma,
        nothing if over is None else over,
        over is not None,
        seen.cells,
        seen.grey,
        seen.columns,
        seen.parts,
        seen.error_model.shift,
        seen.error_model.factor,
        np.float32(seen.gross),
        network is not None,
        np.zeros((1, 1), np.uint8) if labels is None else labels,
        labels is not None,
        classes.sky,
        standing.odds,
        standing.feet,
        np.float32(standing.focal),
        classes.canopy_log_odds,
        source,
    )


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def _combine(
    depth: Float32Array,
    sigma: Float32Array,
    over: Float32Array,
    has_over: bool,
    cells: Float32Array,
    grey: UInt8Array,
    columns: Int32Array,
    parts: Float32Array,
    shift: Float32Array,
    factor: Float32Array,
    gross: np.float32,
    usable: bool,
    labels: UInt8Array,
    labelled: bool,
    sky: int,
    odds: Float32Array,
    feet: Float32Array,
    focal: np.float32,
    prefers_over: Float32Array,
    source: UInt8Array,
) -> None:
    """What is absent, as `has_over`, `usable` and `labelled` say, is of size 1 or 2.

    Row by row (see `fusion_rows`): only the pixels where terrain and network disagree are looked at one by one.
    """
    half, one, far = np.float32(0.5), np.float32(1.0), np.float32(1e9)
    height, width = depth.shape
    cols = shift.shape[1]
    tables = interpolation_table(shift, factor)
    table = (np.arange(width) * cols // width).astype(np.int32)
    between, seen = np.empty((4, cells.shape[2]), np.float32), np.empty((3, width), np.float32)
    y, near, back = seen[0], seen[1], seen[2]
    work = np.empty((7, width), np.float32)
    true, own, less, spread, off, joint, weight = work[0], work[1], work[2], work[3], work[4], work[5], work[6]
    place = np.empty(width, np.int32)
    unlabelled = np.full(width, np.uint8(255))
    asked = np.zeros(width, np.bool_)
    cell = (np.arange(width) * odds.shape[1] // width).astype(np.int32)
    for v in range(height - 1, -1, -1):
        i = v * shift.shape[0] // height
        d, s, kind = depth[v], sigma[v], source[v]
        label = labels[v] if labelled else unlabelled
        at = odds[v * odds.shape[0] // height]
        if usable:
            upsample_row(cells, grey, columns, parts, v, between, seen)
        if has_over:
            _choose(d, s, over[v], y, usable, i, table, shift, factor, label, prefers_over)
        begin_row(d, s, kind)
        if not usable:
            continue
        count = compare_row(
            d, s, y, near, back, tables[i], table, place, label, sky, true, own, less, spread, off, joint, weight, asked
        )
        average_row(d, s, kind, true, own, off, joint, weight)
        if not count:
            continue
        for u in np.flatnonzero(asked):
            other, likely, foot = y[u], one, 0
            nearer = kind[u] > 0 and off[u] > 0
            if nearer:
                # Something stands there? At a soft edge only where the network is nearer to the near side; away from
                # edges what neighbours see is but their own place.
                known = at[cell[u]]
                edge = (near[u] - y[u]) / off[u]
                if not edge < one or _surely_terrain(known, near[u], true[u], off[u], joint[u], spread[u]):
                    continue
                other = y[u] if edge < np.float32(_BLURRED) else near[u]
                column = feet[cell[u]]
                foot = ground_contact(other, column, v)
                known = occlusion_log_odds(known, other, true[u], edge, column, v, foot, focal)
                likely = _likely(other, off[u], joint[u], spread[u], gross, known, np.float32(_HEARD))
            elif kind[u]:
                # Or is something gone? That is not asked at edges, where the far side, or sky, may have leaked in.
                if not near[u] - back[u] < -off[u]:
                    continue
                likely = _likely(other, off[u], joint[u], spread[u], gross, np.float32(_VANISHED), one)
            if not (likely >= np.float32(OPEN) and other > 0):
                continue
            inverse, t = invert(i, table[u], other, shift, factor)
            if nearer:
                # The shifts were learnt on ground; what stands before it is told by the line alone, and that it is
                # there is known even where its depth is as good as not.
                t, inverse = min(t * other / inverse, np.float32(0.99) * other), other
            if not (t < inverse and (kind[u] == 0 or (inverse > true[u]) == (off[u] > 0))):
                continue
            t = elsewhere(t, near[u], back[u])
            if nearer:
                inverse, t = snap_to_contact(inverse, t, feet[cell[u]], foot)
            t /= inverse * inverse
            if d[u] < far and likely < np.float32(1.0 - OPEN):
                d[u], s[u] = mixture_moments(d[u], s[u], one / inverse, t, likely)
            elif likely > half:
                d[u], s[u] = one / inverse, t
            kind[u] = 2 if likely > half else kind[u]


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def elsewhere(t: np.float32, near: np.float32, back: np.float32) -> np.float32:
    """A network's sigma, 1/m, of what may stand before the ground, of which its own is `t`; which of its neighbours'
    depths, from `back` to `near`, a pixel has stays unsure."""
    between = np.float32(_BETWEEN) * (near - back)
    return np.float32(np.sqrt(np.float32(_ELSEWHERE) * t * t + between * between))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _surely_terrain(
    odds: np.float32, near: np.float32, true: np.float32, off: np.float32, joint: np.float32, spread: np.float32
) -> bool:
    """Whether a disagreement is surely too small for `_likely` to find anything before the ground: its odds at their
    best, without exponential and logarithm."""
    if joint > np.float32(_OWN) * spread * spread:
        return False
    ratio = np.float32(MOST_RATIO)
    if true * (np.float32(1.0) + ratio) > near:
        ratio = near / true - np.float32(1.0)  # at least the logarithm
    need = (np.float32(_FEW) - odds - np.float32(NEARER) * ratio) * np.float32(1.0 / _HEARD)
    return bool(off * off < np.float32(2.0) * joint * (need + np.float32(_WIDEST)))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _likely(
    other: np.float32,
    off: np.float32,
    joint: np.float32,
    spread: np.float32,
    gross: np.float32,
    odds: np.float32,
    heard: np.float32,
) -> np.float32:
    """Chance that the inverse depth `other`, 1/m, is the network's alone, and not the terrain's word.

    `off`: by how much it is nearer than it would say of the terrain, with variance `joint`, of its own `spread`.
    `odds`: log odds of something that stands there, or is gone; `heard`: the part of the log likelihood that counts.
    """
    fits = np.exp(np.float32(-0.5) * off * off / joint) / np.sqrt(np.float32(2 * np.pi) * joint)
    # Against one that is anywhere before the ground: fits, or a gross error, which is anywhere too.
    against = (np.float32(1.0) - gross) * fits * np.float32(_RANGES) * max(other, spread) + gross
    return np.float32(np.float32(1.0) / (np.float32(1.0) + np.exp(heard * np.log(against) - odds)))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _choose(
    depth: Float32Array,
    sigma: Float32Array,
    over: Float32Array,
    seen: Float32Array,
    usable: bool,
    i: int,
    table: Int32Array,
    shift: Float32Array,
    factor: Float32Array,
    labels: UInt8Array,
    prefers_over: Float32Array,
) -> None:
    """Bare ground or canopy, in one row: the label's odds, and which of the two the network is nearer to."""
    far, one, half = np.float32(1e9), np.float32(1.0), np.float32(0.5)
    for u in range(len(depth)):
        c, d, s = over[u], depth[u], sigma[u]
        if c < far and (not d < far or abs(c - d) > s):
            odds = prefers_over[labels[u]]
            if usable and seen[u] == seen[u]:
                y, a = seen[u], np.float32(0.0)
                if d < far:
                    a = one / d
                m, t = expected_prediction(i, table[u], a, shift, factor)
                to_ground = (y - a + m) / t
                for_over = half * to_ground * to_ground + np.log(t)
                m, t = expected_prediction(i, table[u], one / c, shift, factor)
                to_over = (y - one / c + m) / t
                for_over -= half * to_over * to_over + np.log(t)
                odds += np.float32(_HEARD_OVER) * for_over
            likely = one / (one + np.exp(-odds))
            top = np.float32(0.03) * c if np.isnan(s) else max(s, np.float32(0.01) * c)
            if d < far and min(likely, one - likely) > np.float32(OPEN):
                depth[u], sigma[u] = mixture_moments(d, s, c, top, likely)
            elif odds > 0:
                depth[u], sigma[u] = c, top
