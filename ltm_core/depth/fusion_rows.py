"""Rows of pixels, whole: the terrain beside what a network sees, and their mean where both agree.

What nearly all pixels need is computed in short loops without branches, which compilers turn into vector code.
"""

from __future__ import annotations

import numba
import numpy as np

from ltm_core.depth.error_model import expected_predictions
from ltm_core.types import BoolArray, Float32Array, Int32Array, UInt8Array

_ODD = 0.4  # sigmas, squared, from which on a disagreement is looked at
_TORN = 0.15  # of its depth: sigma of a terrain that is torn between two surfaces; nothing is at their mean
_SOFT = 0.15  # of the range of a network's depth among neighbours: how far a pixel between them may be off


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def compare_row(
    d: Float32Array,
    s: Float32Array,
    y: Float32Array,
    near: Float32Array,
    back: Float32Array,
    tables: Float32Array,
    table: Int32Array,
    place: Int32Array,
    label: UInt8Array,
    sky: int,
    true: Float32Array,
    own: Float32Array,
    less: Float32Array,
    spread: Float32Array,
    off: Float32Array,
    joint: Float32Array,
    part: Float32Array,
    asked: BoolArray,
) -> int:
    """One row of terrain, depth `d` and sigma `s`, beside what the network sees, `y`, `near` and `back`.

    Fills `true`, the terrain's inverse depth, 0 for sky and unknown ground, and `own`, its sigma; `spread`, the
    network's; `off`, by how much that is nearer than it would say of the terrain, with the variance `joint`; and
    `asked`, whether the two disagree or the terrain is unknown; how many. Compilers give up on loops that write into
    several of many arrays: one result a loop.
    """
    width, far, one, none = len(d), np.float32(1e9), np.float32(1.0), np.float32(0.0)
    for u in range(width):
        true[u] = one / d[u] if d[u] < far else none
    for u in range(width):
        b = s[u] * true[u] * true[u]
        own[u] = b if d[u] < far else none
    expected_predictions(true, tables, table, place, part, less, spread)
    for u in range(width):
        off[u] = y[u] - true[u] + less[u]
    for u in range(width):
        # At an edge the network's depth is the other side's in part.
        soft = np.float32(_SOFT) * (near[u] - back[u])
        joint[u] = spread[u] * spread[u] + own[u] * own[u] + soft * soft
    count = 0
    for u in range(width):
        odd = (off[u] * off[u] > np.float32(_ODD) * joint[u]) & ((off[u] > 0) | (d[u] < far))
        ask = (label[u] != sky) & (odd | ((d[u] != d[u]) & (y[u] == y[u])))
        asked[u] = ask
        count += ask
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract"})  # type: ignore[untyped-decorator]
def average_row(
    d: Float32Array,
    s: Float32Array,
    kind: UInt8Array,
    true: Float32Array,
    own: Float32Array,
    off: Float32Array,
    joint: Float32Array,
    weight: Float32Array,
) -> None:
    """Mean by inverse variance, in inverse depth, where both agree within three sigmas and the terrain is one surface;
    see `compare_row`."""
    width, one = len(d), np.float32(1.0)
    for u in range(width):
        w = own[u] * own[u] / joint[u]
        fits = (off[u] * off[u] <= np.float32(9.0) * joint[u]) & (true[u] + w * off[u] > np.float32(0.5) * true[u])
        weight[u] = w if fits & (own[u] > 0) & (own[u] < np.float32(_TORN) * true[u]) else np.float32(-1.0)
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
