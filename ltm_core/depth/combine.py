"""Terrain or network, pixel by pixel.

If the terrain were right, what would the network say here, and how surely (`answers`)? Where it says that, both are
averaged by inverse variance, in inverse depth: far away the terrain decides, since a network's sigma grows with the
square of the depth. Where it says something else, either something stands before the terrain, or it is gone, or the
network is wrong; the chance of each, by the class that the label gives, decides whether the network alone is taken.
Where that is nearly open, depth is the mean of both as likely as they are, and sigma owns up to it.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from ltm_core.depth.answers import meant, pairs, said
from ltm_core.depth.classes import DepthClasses
from ltm_core.depth.rows import average, begin, compare
from ltm_core.depth.seen import SeenDepth, see_row

Image = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Row = NDArray[np.float32]

VANISHED = 0.01
"""Chance that the ground of a pixel is gone, so that something farther shows."""
MOST_RATIO = 3.0
"""E-foldings of depth between ground and what stands before it from which on its chance grows no more."""
EDGE = 0.5
"""What log odds lose at an edge as high as the disagreement, and less by its square."""
_ELSEWHERE = 4.0  # times a network's variance on ground: its variance on what stands before it
_BETWEEN = 0.3  # of the range of a network's depth among neighbours: sigma of which of them a pixel shows
_BLURRED = 0.3  # of a disagreement: what lies between two sides by more is an edge
_OPEN = 0.2  # chance from which on a depth counts beside the likelier one
_OWN = 4.0  # of a network's own variance: below it, `_least` is no more than `_alone`
_RANGES = 3.0  # e-foldings of depth over which something that stands before the terrain may be, each as likely


def combine(
    depth: Image,
    sigma: Image,
    over: Image | None,
    network: SeenDepth | None,
    labels: Bytes | None,
    classes: DepthClasses,
    source: Bytes,
) -> None:
    """Fuse in place: `depth` and `sigma` (H, W) come in as the terrain's and go out as the fused ones, `source` as
    `fusion.Source`.

    `over`: (H, W) depth of a canopy raster, `network`: what it sees, `labels`: (H, W) class ids; None where there is
    none.
    """
    nothing = np.zeros((1, 1), np.float32)
    seen = SeenDepth.none() if network is None else network
    _combine(
        depth,
        sigma,
        nothing if over is None else over,
        over is not None,
        seen.cells,
        seen.grey,
        seen.columns,
        seen.parts,
        seen.answers.shift,
        seen.answers.factor,
        np.float32(seen.gross),
        network is not None,
        np.zeros((1, 1), np.uint8) if labels is None else labels,
        labels is not None,
        classes.sky,
        classes.standing,
        classes.surface,
        source,
    )


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def _combine(
    depth: Image,
    sigma: Image,
    over: Image,
    has_over: bool,
    cells: Image,
    grey: Bytes,
    columns: NDArray[np.int32],
    parts: Row,
    shift: Image,
    factor: Image,
    gross: np.float32,
    usable: bool,
    labels: Bytes,
    labelled: bool,
    sky: int,
    standing: NDArray[np.float32],
    prefers_over: NDArray[np.float32],
    source: Bytes,
) -> None:
    """What is absent, as `has_over`, `usable` and `labelled` say, is of size 1 or 2.

    Row by row (see `rows`): only the pixels where terrain and network disagree are looked at one by one.
    """
    half, one, far = np.float32(0.5), np.float32(1.0), np.float32(1e9)
    height, width = depth.shape
    cols = shift.shape[1]
    tables = pairs(shift, factor)
    table = (np.arange(width) * cols // width).astype(np.int32)
    between, seen = np.empty((4, cells.shape[2]), np.float32), np.empty((3, width), np.float32)
    y, near, back = seen[0], seen[1], seen[2]
    work = np.empty((7, width), np.float32)
    true, own, less, spread, off, joint, weight = work[0], work[1], work[2], work[3], work[4], work[5], work[6]
    place = np.empty(width, np.int32)
    unlabelled = np.full(width, np.uint8(255))
    asked = np.zeros(width, np.bool_)
    gone = np.float32(_least(VANISHED))
    # Of what is so much nearer that its chance grows no more.
    least = np.array([_least(_standing(one, np.float32(0.0), np.float32(0.0), k)) for k in standing]).astype(np.float32)
    for v in range(height - 1, -1, -1):
        i = v * shift.shape[0] // height
        d, s, kind = depth[v], sigma[v], source[v]
        label = labels[v] if labelled else unlabelled
        if usable:
            see_row(cells, grey, columns, parts, v, between, seen)
        if has_over:
            _choose(d, s, over[v], y, usable, i, table, shift, factor, label, prefers_over)
        begin(d, s, kind)
        if not usable:
            continue
        count = compare(
            d, s, y, near, back, tables[i], table, place, label, sky, true, own, less, spread, off, joint, weight, asked
        )
        average(d, s, kind, true, own, off, joint, weight)
        if not count:
            continue
        for u in np.flatnonzero(asked):
            other, likely = y[u], one
            if kind[u]:
                chance = np.float32(VANISHED)
                if off[u] > 0:
                    chance = _standing(near[u], true[u], (near[u] - y[u]) / off[u], standing[label[u]])
                surely = joint[u] * (least[label[u]] if off[u] > 0 else gone)
                if joint[u] < np.float32(_OWN) * spread[u] * spread[u] and off[u] * off[u] < surely:
                    continue
                other, likely = _alone(other, near[u], back[u], off[u], joint[u], spread[u], gross, chance)
            if not other > 0:
                continue
            inverse, t = meant(i, table[u], other, shift, factor)
            if kind[u] and off[u] > 0:
                # The shifts were learnt on ground; what stands before it is told by the line alone, and that it is
                # there is known even where its depth is as good as not.
                t, inverse = min(t * other / inverse, np.float32(0.99) * other), other
            if not (t < inverse and (kind[u] == 0 or (inverse > true[u]) == (off[u] > 0))):
                continue
            t = elsewhere(t, near[u], back[u]) / (inverse * inverse)
            if d[u] < far and likely < np.float32(1.0 - _OPEN):
                d[u], s[u] = _either(d[u], s[u], one / inverse, t, likely)
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
def _standing(near: np.float32, true: np.float32, edge: np.float32, odds: Row) -> np.float32:
    """Chance that something stands at inverse depth `near` before ground at `true`, where an edge is as high as `edge`
    of the disagreement. `odds`: see `STANDING`."""
    ratio = np.float32(MOST_RATIO)
    if true * np.float32(np.exp(MOST_RATIO)) > near:
        ratio = np.log(near / true)
    log_odds = odds[0] + odds[1] * ratio - np.float32(EDGE) * edge * edge
    return np.float32(1.0 / (1.0 + np.exp(-log_odds)))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _least(chance: float) -> float:
    """Squared sigmas below which a thing of such a chance never counts where the variance is the network's own:
    `_alone`'s odds at their best, without the exponential."""
    if chance <= 0:
        return np.inf
    odds = _OPEN / (1.0 - _OPEN) * (1.0 - chance) / chance
    return float(2.0 * np.log(odds * _RANGES / np.sqrt(2.0 * np.pi * _OWN)))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _alone(
    y: np.float32,
    near: np.float32,
    back: np.float32,
    off: np.float32,
    joint: np.float32,
    spread: np.float32,
    gross: np.float32,
    chance: np.float32,
) -> tuple[np.float32, np.float32]:
    """The inverse depth, 1/m, that is the network's alone, 0 where only the terrain's word counts, and its chance.

    `y`: what the network sees, `near` and `back` its neighbours. `off`: by how much it is nearer than it would say of
    the terrain, with variance `joint`, of its own `spread`. `chance`: of something that stands there, or is gone.
    """
    half, none, one = np.float32(0.5), np.float32(0.0), np.float32(1.0)
    # Something stands there? At a soft edge only where the network is nearer to the near side. Or is something gone?
    # That is not asked at edges, where the far side, or sky, may have leaked in.
    other = near if off > 0 else y
    edge = near - y if off > 0 else near - back
    if not edge < abs(off):
        return none, none
    fits = np.exp(-half * off * off / joint) / np.sqrt(np.float32(2 * np.pi) * joint)
    density = one / (np.float32(_RANGES) * max(other, spread))
    stands = chance * density
    likely = stands / (stands + (one - chance) * ((one - gross) * fits + gross * density))
    if likely < np.float32(_OPEN):
        return none, likely
    # Away from edges what neighbours see is but their own place.
    return (y if edge < np.float32(_BLURRED) * abs(off) else other), likely


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _either(
    d: np.float32, s: np.float32, other: np.float32, t: np.float32, likely: np.float32
) -> tuple[np.float32, np.float32]:
    """Mean and sigma, metres, of a depth that is `other`, of sigma `t`, as `likely` as that and else `d`, of `s`."""
    rest = np.float32(1.0) - likely
    apart = other - d
    return d + likely * apart, np.sqrt(likely * t * t + rest * s * s + likely * rest * apart * apart)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _choose(
    depth: Row,
    sigma: Row,
    over: Row,
    seen: Row,
    usable: bool,
    i: int,
    table: NDArray[np.int32],
    shift: Image,
    factor: Image,
    labels: NDArray[np.uint8],
    prefers_over: NDArray[np.float32],
) -> None:
    """Bare ground or canopy, in one row: the label's odds, and which of the two the network is nearer to."""
    far, one, half, most = np.float32(1e9), np.float32(1.0), np.float32(0.5), np.float32(4.0)
    for u in range(len(depth)):
        c, d, s = over[u], depth[u], sigma[u]
        if c < far and (not d < far or abs(c - d) > s):
            usual = prefers_over[labels[u]]
            odds = usual
            if usable and seen[u] == seen[u]:
                y, a = seen[u], np.float32(0.0)
                if d < far:
                    a = one / d
                m, t = said(i, table[u], a, shift, factor)
                to_ground = (y - a + m) / t
                odds += half * to_ground * to_ground + np.log(t)
                m, t = said(i, table[u], one / c, shift, factor)
                to_over = (y - one / c + m) / t
                odds -= half * to_over * to_over + np.log(t)
                odds = min(max(odds, usual - most), usual + most)
            if odds > 0:
                sigma[u] = np.float32(0.03) * c if np.isnan(s) else max(s, np.float32(0.01) * c)
                depth[u] = c
