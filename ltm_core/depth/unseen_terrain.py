"""Find pixels without traced terrain: hidden by structures, sky by the labels, and unknown regions."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Int32Array, Int64Array, UInt8Array
from ltm_core.depth.occlusion_prior import DepthDiscontinuities
from ltm_core.vision.labels import UNLABELLED


def labels_behind(hidden: BoolArray, labels: UInt8Array, ground: Float32Array, sky: int) -> UInt8Array:
    """Return labels (H, W) in which hidden pixels (H, W) have the expected label: sky where no ground is traced."""
    behind = np.where(np.isfinite(ground), np.uint8(UNLABELLED), np.uint8(sky))
    return np.asarray(np.where(hidden, behind, labels), np.uint8)


def edges_seen(edges: DepthDiscontinuities, hidden: BoolArray) -> DepthDiscontinuities:
    """Return edges without those that hidden pixels (H, W) cover or that border the hidden area."""
    above = np.maximum(edges.rows - 1, 0)
    seen = ~(hidden[edges.rows, edges.cols] | hidden[above, edges.cols])
    return DepthDiscontinuities(edges.rows[seen], edges.cols[seen], edges.jump)


def hidden_at(hidden: BoolArray, height: int, width: int) -> BoolArray:
    """Return `hidden` (H, W) at another size, edge to edge: True if any of the area of a pixel is hidden."""
    if hidden.shape == (height, width):
        return hidden
    shrinks = height <= hidden.shape[0] and width <= hidden.shape[1]
    method = cv2.INTER_AREA if shrinks else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(hidden.astype(np.float32), (width, height), interpolation=method) > 0, np.bool_)


def with_labelled_sky(depth: Float32Array, labels: UInt8Array, sky: int) -> Float32Array:
    """Return the traced depth (H, W) with +inf for NaN where `labels` (H, W) are sky; unchanged depth is returned
    itself."""
    if not _call_sky(depth, labels, sky, depth[:0]):
        return depth
    called = depth.copy()
    _call_sky(depth, labels, sky, called)
    return called


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _call_sky(depth: Float32Array, labels: UInt8Array, sky: int, called: Float32Array) -> int:
    """Return the number of such pixels; they are made sky in `called`, unless that is empty."""
    height, width = depth.shape
    below_sky = np.ones(width, np.bool_)
    left, found = width, 0
    for v in range(height):
        if left == 0:
            break
        for u in range(width):
            if not below_sky[u]:
                continue
            d = depth[v, u]
            if labels[v, u] != sky or d < np.float32(np.inf):
                below_sky[u] = False
                left -= 1
            elif d != d:
                found += 1
                if called.size:
                    called[v, u] = np.float32(np.inf)
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def clear_unenclosed(ground: Float32Array, depth: Float32Array, sigma: Float32Array, source: UInt8Array) -> None:
    """Make unknown in `depth`, `sigma` (H, W) and `source` what regions of NaN in the traced `ground` (H, W) cover that
    touch sky or the image's edge, by a corner or more.

    Regions are made of runs of pixels in rows: there are few of them, so that each pixel is looked at once.
    """
    height, width = ground.shape
    rows, starts, ends = _runs(ground)
    count = len(rows)
    parent = np.arange(count)
    open_ended = np.zeros(count, np.bool_)
    previous, first = 0, 0  # the runs of the row above are those from `previous` to `first`
    for k in range(count):
        v, start, end = rows[k], starts[k], ends[k]
        if k == 0 or rows[k - 1] != v:
            previous = first if k and rows[k - 1] == v - 1 else k
            first = k
        open_ended[k] = v == 0 or v == height - 1 or start == 0 or end == width or _sky_beside(ground, v, start, end)
        while previous < first and ends[previous] < start:
            previous += 1
        j = previous
        while j < first and starts[j] <= end:
            a, b = _root(parent, j), _root(parent, k)
            if a != b:
                parent[b] = a
                open_ended[a] |= open_ended[b]
            j += 1
        open_ended[_root(parent, k)] |= open_ended[k]
    for k in range(count):
        if open_ended[_root(parent, k)]:
            v = rows[k]
            for u in range(starts[k], ends[k]):
                if source[v, u] != 0:
                    depth[v, u], sigma[v, u], source[v, u] = np.float32(np.nan), np.float32(np.nan), 0


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _runs(ground: Float32Array) -> tuple[Int32Array, Int32Array, Int32Array]:
    """Return the row, first column and the column behind the last of every run of NaN, row by row."""
    height, width = ground.shape
    counts = np.zeros(height, np.int32)
    for v in range(height):
        line, before = ground[v, 1:], ground[v, :-1]
        count = np.int32(ground[v, 0] != ground[v, 0])
        for u in range(len(line)):
            count += np.int32((line[u] != line[u]) & (before[u] == before[u]))
        counts[v] = count
    total = counts.sum()
    rows, starts, ends = np.empty(total, np.int32), np.empty(total, np.int32), np.empty(total, np.int32)
    k = 0
    for v in range(height):
        line, u = ground[v], 0
        for _ in range(counts[v]):
            while line[u] == line[u]:
                u += 1
            rows[k], starts[k] = v, u
            while u < width and line[u] != line[u]:
                u += 1
            ends[k] = u
            k += 1
    return rows, starts, ends


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _sky_beside(ground: Float32Array, v: int, start: int, end: int) -> bool:
    """Return whether a run that does not touch the image's edge has sky next to it."""
    sky = np.float32(np.inf)
    if ground[v, start - 1] == sky or ground[v, end] == sky:
        return True
    found = False
    for u in range(start - 1, end + 1):
        found |= ground[v - 1, u] == sky or ground[v + 1, u] == sky
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _root(parent: Int64Array, k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


MOST_UNKNOWN = 0.5
"""Share of unknown pixels above which a photo is reported as mostly unknown."""
_EVERY = 4  # pixels looked at, each way


@dataclass(frozen=True)
class UnknownShare:
    """Shares of an image that are unknown: `beyond` known ground, up to the sky; `between` known ground; `before` the
    first known ground; and in columns with `no_ground`."""

    beyond: float
    between: float
    before: float
    no_ground: float

    @property
    def whole(self) -> float:
        return self.beyond + self.between + self.before + self.no_ground

    @property
    def reason(self) -> str:
        """Return the share, and its most likely reason."""
        likely = max(
            (self.beyond, "the view extends beyond the DEM's edge; give a coarser DEM around it, or possible_ground"),
            (self.between, "the DEM has holes there"),
            (self.before, "the camera is beyond the DEM's edge or next to a hole"),
            (self.no_ground, "the view misses the DEM; check position and azimuth, or give a larger DEM"),
        )
        return f"{self.whole:.0%} of the image is unknown ground: {likely[1]}"


def unknown_share(depth: Float32Array) -> UnknownShare:
    """Return the unknown share of ranges or depths (H, W): finite, +inf sky, NaN unknown; every fourth pixel each way
    is used."""
    part = depth[::_EVERY, ::_EVERY]
    unknown, known = np.isnan(part), np.isfinite(part)
    above = np.logical_or.accumulate(known, axis=0)
    below = np.logical_or.accumulate(known[::-1], axis=0)[::-1]
    return UnknownShare(
        float((unknown & below & ~above).mean()),
        float((unknown & below & above).mean()),
        float((unknown & ~below & above).mean()),
        float((unknown & ~below & ~above).mean()),
    )
