"""Terrain or network, pixel by pixel.

If the terrain were right, what would the network say here, and how surely (`answers`)? Where it says that, both are
averaged by inverse variance, in inverse depth: far away the terrain decides, since a network's sigma grows with the
square of the depth. Where it says something else, either something stands before the terrain, or it is gone, or the
network is wrong; the chance of each, by the class that the label gives, decides whether the network alone is taken.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from ltm_core.depth.answers import pairs, said, said_at
from ltm_core.depth.classes import DepthClasses
from ltm_core.depth.odds import FOOTLESS_ODDS, gone, least, of_network, stands, take, weigh
from ltm_core.depth.seen import SeenDepth, see_row

Image = NDArray[np.float32]
Bytes = NDArray[np.uint8]
Row = NDArray[np.float32]

FOOTLESS = 1.5
"""What the network sees nearer than all ground below it in the photo by this factor has no foot that it stands on;
unless it reaches down to the photo's edge, which then cuts the foot off."""
_CUT = 0.5  # of its inverse depth that all below a thing is seen at which reaches down to the edge
_SOFT = 0.15  # of the range of a network's depth among neighbours: how far a pixel between them may be off
_BLURRED = 0.3  # of a disagreement: what lies between two sides by more is an edge
_GONE = 8.0  # variances of a disagreement below which ground is never gone


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


def fill_holes(
    holes: NDArray[np.int32],
    depth: Image,
    sigma: Image,
    network: SeenDepth,
    labels: Bytes | None,
    classes: DepthClasses,
    source: Bytes,
) -> None:
    """Give the network's depth to what is unknown of `holes`, runs of pixels as `clear_beyond` gives them, and not
    labelled sky."""
    _fill(
        holes,
        depth,
        sigma,
        network.cells,
        network.grey,
        network.columns,
        network.parts,
        network.answers.shift,
        network.answers.factor,
        np.zeros((1, 1), np.uint8) if labels is None else labels,
        labels is not None,
        classes.sky,
        source,
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _fill(
    holes: NDArray[np.int32],
    depth: Image,
    sigma: Image,
    cells: Image,
    grey: Bytes,
    columns: NDArray[np.int32],
    parts: Row,
    shift: Image,
    factor: Image,
    labels: Bytes,
    labelled: bool,
    sky: int,
    source: Bytes,
) -> None:
    height, width = depth.shape
    between, seen = np.empty((4, cells.shape[2]), np.float32), np.empty((3, width), np.float32)
    last = -1
    for v, start, end in holes:
        if v != last:
            see_row(cells, grey, columns, parts, v, between, seen)
            last = v
        for u in range(start, end):
            if source[v, u] == 0 and not (labelled and labels[v, u] == sky):
                at = v * shift.shape[0] // height, u * shift.shape[1] // width
                inverse, t = of_network(seen[0, u], seen[1, u], seen[2, u], at, shift, factor)
                take(depth[v], sigma[v], source[v], u, inverse, t)


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

    Row by row: what nearly all pixels need is computed in short loops without branches, which compilers turn into
    vector code; only the pixels where terrain and network disagree are then looked at one by one.
    """
    one = np.float32(1.0)
    height, width = depth.shape
    cols = shift.shape[1]
    tables = pairs(shift, factor)
    table = (np.arange(width) * cols // width).astype(np.int32)
    foot, cut = np.full(width, np.float32(np.inf)), np.full(width, np.float32(np.inf))
    between, seen = np.empty((4, cells.shape[2]), np.float32), np.empty((3, width), np.float32)
    y, near, back = seen[0], seen[1], seen[2]
    work = np.empty((7, width), np.float32)
    true, own, less, spread, off, joint, weight = work[0], work[1], work[2], work[3], work[4], work[5], work[6]
    place = np.empty(width, np.int32)
    unlabelled = np.full(width, np.uint8(255))
    asked = np.zeros(width, np.bool_)
    passed = np.array([least(odds) for odds in standing]).astype(np.float32)
    for v in range(height - 1, -1, -1):
        i = v * shift.shape[0] // height
        d, s, kind = depth[v], sigma[v], source[v]
        label = labels[v] if labelled else unlabelled
        if usable:
            see_row(cells, grey, columns, parts, v, between, seen)
        if has_over:
            _choose(d, s, over[v], y, usable, i, table, shift, factor, label, prefers_over)
        _begin(d, s, kind, foot)
        if not usable:
            continue
        for u in range(width):
            # The farthest that the network sees from here down to the photo's edge.
            cut[u] = y[u] if y[u] < cut[u] else cut[u]
        count = _compare(
            d, s, y, near, back, tables[i], table, place, label, sky, true, own, less, spread, off, joint, weight, asked
        )
        _average(d, s, kind, true, own, off, joint, weight)
        if count:
            for u in range(width):
                if not asked[u]:
                    continue
                at = i, table[u]
                if off[u] * off[u] < joint[u] * (passed[label[u]] if off[u] > 0 else np.float32(_GONE)):
                    continue
                if off[u] < 0:
                    if gone(y[u], near[u], back[u], off[u], joint[u], spread[u], gross):
                        inverse, t = of_network(y[u], near[u], back[u], at, shift, factor)
                        if inverse < true[u]:
                            take(d, s, kind, u, inverse, t)
                else:
                    edge = (near[u] - y[u]) / off[u]
                    if edge < one:
                        # At a soft edge the near side's depth counts; away from edges a pixel's own.
                        read = y[u] if edge < np.float32(_BLURRED) else near[u]
                        inverse, t = of_network(read, near[u], back[u], at, shift, factor)
                        if inverse > true[u]:
                            odds = stands(inverse, true[u], edge, off[u] * off[u] / joint[u], standing[label[u]])
                            if near[u] * foot[u] > np.float32(FOOTLESS) and cut[u] < np.float32(_CUT) * near[u]:
                                odds += np.float32(FOOTLESS_ODDS)
                            weigh(d, s, kind, u, inverse, t, odds)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def _compare(
    d: Row,
    s: Row,
    y: Row,
    near: Row,
    back: Row,
    tables: Image,
    table: NDArray[np.int32],
    place: NDArray[np.int32],
    label: NDArray[np.uint8],
    sky: int,
    true: Row,
    own: Row,
    less: Row,
    spread: Row,
    off: Row,
    joint: Row,
    part: Row,
    asked: NDArray[np.bool_],
) -> int:
    """One row of terrain, depth `d` and sigma `s`, beside what the network sees, `y`, `near` and `back`.

    Fills `true`, the terrain's inverse depth, 0 for sky and unknown ground, and `own`, its sigma; `spread`, the
    network's; `off`, by how much that is nearer than it would say of the terrain, with the variance `joint`; and
    `asked`, whether the two disagree; how many. Compilers give up on loops that write into
    several of many arrays: one result a loop.
    """
    width, far, one, none = len(d), np.float32(1e9), np.float32(1.0), np.float32(0.0)
    for u in range(width):
        true[u] = one / d[u] if d[u] < far else none
    for u in range(width):
        b = s[u] * true[u] * true[u]
        own[u] = b if d[u] < far else none
    said_at(true, tables, table, place, part, less, spread)
    for u in range(width):
        off[u] = y[u] - true[u] + less[u]
    for u in range(width):
        # At an edge the network's depth is the other side's in part.
        soft = np.float32(_SOFT) * (near[u] - back[u])
        joint[u] = spread[u] * spread[u] + own[u] * own[u] + soft * soft
    count = 0
    for u in range(width):
        odd = (off[u] * off[u] > np.float32(2.0) * joint[u]) & ((off[u] > 0) | (d[u] < far))
        ask = (label[u] != sky) & odd & (d[u] == d[u])
        asked[u] = ask
        count += ask
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def _average(d: Row, s: Row, kind: NDArray[np.uint8], true: Row, own: Row, off: Row, joint: Row, weight: Row) -> None:
    """Mean by inverse variance, in inverse depth, where both agree within three sigmas; see `_compare`."""
    width, one = len(d), np.float32(1.0)
    for u in range(width):
        w = own[u] * own[u] / joint[u]
        fits = (off[u] * off[u] <= np.float32(9.0) * joint[u]) & (true[u] + w * off[u] > np.float32(0.5) * true[u])
        weight[u] = w if fits & (own[u] > 0) else np.float32(-1.0)
    for u in range(width):
        d[u] = one / (true[u] + weight[u] * off[u]) if weight[u] >= 0 else d[u]
    for u in range(width):
        s[u] = own[u] * np.sqrt(one - weight[u]) * d[u] * d[u] if weight[u] >= 0 else s[u]
    for u in range(width):
        kind[u] = 3 if weight[u] > np.float32(0.1) else kind[u]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def _begin(d: Row, s: Row, kind: NDArray[np.uint8], foot: Row) -> None:
    """What a row is without a network, and the nearest ground from here down."""
    far, none = np.float32(1e9), np.float32(np.nan)
    for u in range(len(d)):
        foot[u] = d[u] if d[u] < foot[u] else foot[u]
    for u in range(len(d)):
        kind[u] = 1 if d[u] < far else (4 if d[u] > far else 0)
    for u in range(len(d)):
        s[u] = s[u] if d[u] < far else none


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
