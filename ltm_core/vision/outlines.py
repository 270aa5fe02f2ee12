"""Outlines of a region of a picture as polygons; a hole becomes part of its outline, by a cut that leads to it."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.types import BoolArray
from ltm_core.vision.mask_config import MOST_POINTS

Outline = tuple[tuple[float, float], ...]
MOST_HOLES = 200
"""Of one part; the smallest beyond them are filled, so that no outline needs more corners than it may have."""
_Points = NDArray[np.int32]


def polygons_of(region: BoolArray, tolerance: float = 1.0, filled: bool = False) -> list[Outline]:
    """Outlines (u, v) of the parts of (H, W), to `tolerance` pixels or, where one would have more corners than a
    polygon may (`MOST_POINTS`), as much coarser as it must be.

    `filled`: holes are filled. Otherwise the outline goes in to each hole, about it, and back the same way, so that
    filling it by the even-odd rule leaves the hole out.
    """
    mode = cv2.RETR_EXTERNAL if filled else cv2.RETR_CCOMP
    # All pixels of the edges: a cut to a hole ends at one of them.
    contours, tree = cv2.findContours(region.astype(np.uint8), mode, cv2.CHAIN_APPROX_NONE)
    parents = [] if tree is None else tree[0, :, 3].tolist()
    holes_of: dict[int, list[_Points]] = {number: [] for number, parent in enumerate(parents) if parent < 0}
    for contour, parent in zip(contours, parents, strict=True):
        if parent >= 0:
            holes_of[parent].append(np.asarray(contour, np.int32))
    found = []
    for number, holes in holes_of.items():
        holes.sort(key=cv2.contourArea)
        small = max(0, len(holes) - MOST_HOLES)
        solid = region
        if small:  # of this part alone: another one that lies in such a hole keeps its own
            drawn = cv2.drawContours(region.astype(np.uint8), holes[:small], -1, [1], cv2.FILLED)
            solid = np.asarray(drawn, np.uint8) > 0
        edges = [np.asarray(edge[:, 0], np.int32) for edge in (contours[number], *holes[small:])]
        points, fixed = _with_cuts(solid, edges[0], edges[1:])
        found.append(_few_corners(points, fixed, tolerance))
    return sorted(found)


def _with_cuts(region: BoolArray, outer: _Points, holes: list[_Points]) -> tuple[_Points, NDArray[np.bool_]]:
    """One closed line (N, 2) about a part and its holes, and which of its points (N,) a cut begins or ends at."""
    points, fixed = outer, np.zeros(len(outer), np.bool_)
    # From the left: what lies left of a hole, the outline or another hole, is part of the line already.
    for hole in sorted(holes, key=lambda one: int(one[:, 0].min())):
        start = int(np.argmin(hole[:, 0]))
        u, v = (int(value) for value in hole[start])
        beyond = np.flatnonzero(~region[v, :u])
        left = int(beyond[-1]) + 1 if len(beyond) else 0
        at = int(np.flatnonzero((points == (left, v)).all(axis=1))[0])
        around = np.concatenate([hole[start:], hole[: start + 1]])
        ends = np.zeros(len(around), np.bool_)
        ends[[0, -1]] = True
        points = np.concatenate([points[: at + 1], around, points[at:]])
        fixed = np.concatenate([fixed[:at], [True], ends, [True], fixed[at + 1 :]])
    return points, fixed


def _few_corners(points: _Points, fixed: NDArray[np.bool_], tolerance: float) -> Outline:
    """Of a closed line, as few corners as the tolerance lets, and the `fixed` ones; no more than a polygon may have."""
    while True:
        corners = _simplified(points, fixed, tolerance)
        if len(corners) <= MOST_POINTS:
            break
        tolerance *= 2
    # A line or a dot is a polygon too: of three corners, the last of them repeated.
    corners = corners[np.minimum(np.arange(max(3, len(corners))), len(corners) - 1)]
    return tuple((float(u), float(v)) for u, v in corners)


def _simplified(points: _Points, fixed: NDArray[np.bool_], tolerance: float) -> _Points:
    if not fixed.any():
        return np.asarray(cv2.approxPolyDP(points.reshape(-1, 1, 2), tolerance, closed=True)[:, 0], np.int32)
    first = int(np.argmax(fixed))
    line = np.concatenate([points[first:], points[: first + 1]])
    stops = np.flatnonzero(np.concatenate([fixed[first:], fixed[: first + 1]]))
    parts = []
    for a, b in pairwise(stops.tolist()):
        part = line[a : b + 1]
        ends = [0, len(part) - 1]
        if (part[0] == part[-1]).all():  # once around: OpenCV would close it, and begin where it likes
            ends.insert(1, int(np.argmax(((part - part[0]) ** 2).sum(axis=1))))
        for c, d in pairwise(ends):
            parts.append(cv2.approxPolyDP(part[c : d + 1].reshape(-1, 1, 2), tolerance, closed=False)[:-1, 0])
    return np.asarray(np.concatenate(parts), np.int32)
