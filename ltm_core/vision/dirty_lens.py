"""Tells a lens that has become dirty or wet: parts of the picture have lost their fine detail for hours, against the
camera's own earlier pictures of the same view, while the rest is as sharp as ever.

What a part always looked like is the median of clear pictures of hours or days, so that a part which was always smooth,
or which the weather often hides, says little. Fog takes detail as drops do; what tells them apart is that it drifts.
The constants were chosen on half of a set of mountain photos with drops and smears drawn into them; `ltm-lab eval
dirty-lens` scores them on others.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Self

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.vision.usable import WORKING_WIDTH, Unusable, judge

ROWS, COLUMNS = 18, 24
"""Of the grid on which sharpness is compared."""
APART_S = 600.0
"""Between two pictures that are compared, whatever their views: with `AGREEING` of them, fog has more than three hours
to drift."""
HISTORY_APART_S = 1200.0
"""Between two pictures that enter a view's history,"""
HISTORY = 108
"""of which so many are kept: those of three days with twelve hours of light,"""
LEAST_HISTORY = 12
"""and so many are needed, four hours, before anything is told."""
AGREEING = 20
"""Pictures that are looked at together."""
RELEARNT_AFTER_S = 7 * 86_400.0
"""A view that is told so long, and nobody cleans the lens, has changed: it is learnt anew."""
VIEWS = 32
"""That are remembered, those seen last: presets of a patrol."""

_FINE = 1.2
"""Grey levels of fine contrast, in the median, from which on a part has detail to lose."""
_NOISE, _BLACK = 0.3, 8.0
"""Grey levels of fine contrast that noise and compression make of nothing, and of brightness that count as none."""
_LOSS = 0.6
"""By which the logarithm of a part's detail must have fallen,"""
_LOSS_SPREADS = 4.0
"""and by so many of its usual spreads (scaled median absolute deviations)."""
_OFTEN, _STILL = 0.9, 0.5
"""Share of the pictures in which a part is blurred for it to count, and to go on counting."""
_PARTS = 3
"""Blurred parts from which on the lens is told."""


@dataclass(frozen=True, eq=False)
class Detail:
    """Of the parts of a picture, (ROWS, COLUMNS). `fine`: contrast from one pixel to the next, grey levels; `relative`:
    its logarithm against the brightness, from which the shadow of a cloud takes nothing."""

    fine: Float32Array
    relative: Float32Array

    @classmethod
    def of(cls, picture: UInt8Array) -> Self:
        """Of a picture (H, W, 3) RGB, reduced to `WORKING_WIDTH` columns."""
        height, width = picture.shape[:2]
        columns = min(WORKING_WIDTH, width)
        size = columns, max(1, round(height * columns / width))
        small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        grey = cv2.cvtColor(small, cv2.COLOR_RGB2GRAY).astype(np.float32)
        fine = _on_grid(cv2.absdiff(grey, cv2.GaussianBlur(grey, (7, 7), 1.0)))
        return cls(fine, np.log((fine + np.float32(_NOISE)) / (_on_grid(grey) + np.float32(_BLACK))))


@dataclass
class _View:
    """What was seen of one view."""

    details: deque[Detail] = field(default_factory=lambda: deque(maxlen=HISTORY))
    waiting: deque[tuple[float, Detail]] = field(default_factory=deque)
    """With their times, to enter `details`."""
    looked: float = -np.inf
    learnt: float = -np.inf
    usual: tuple[Float32Array, Float32Array, BoolArray] | None = None
    """Of `details` the median and the spread, and which parts have some to lose."""

    def learn(self, seen: Detail, now: float) -> None:
        """Take a clear picture. Once there is a history, it enters when it can no longer be the first of a lens that
        has just become dirty."""
        if now - self.learnt < HISTORY_APART_S:
            return
        self.learnt = now
        self.waiting.append((now, seen))
        entered = False
        while self.waiting and (self.usual is None or now - self.waiting[0][0] > AGREEING * APART_S):
            self.details.append(self.waiting.popleft()[1])
            entered = True
            if len(self.details) < LEAST_HISTORY:
                return
        if entered:
            self._summarise()

    def _summarise(self) -> None:
        relative = np.stack([detail.relative for detail in self.details])
        median = np.median(relative, axis=0)
        spread = 1.4826 * np.median(np.abs(relative - median), axis=0)
        telling = np.median(np.stack([detail.fine for detail in self.details]), axis=0) >= _FINE
        self.usual = np.asarray(median, np.float32), np.asarray(spread, np.float32), telling


class DirtyLens:
    """Pictures of one camera in the order of their times; seconds of any clock that is not set."""

    def __init__(self) -> None:
        self.blurred: BoolArray
        """Parts that are told; none: the lens is clean, or nothing is known yet."""
        self._forget()

    def _forget(self) -> None:
        self._views: dict[int, _View] = {}
        self._lost: deque[BoolArray] = deque(maxlen=AGREEING)
        self._known: deque[BoolArray] = deque(maxlen=AGREEING)
        self._compared = -np.inf
        self._since: float | None = None
        self.blurred = np.zeros((ROWS, COLUMNS), np.bool_)

    def wants(self, view: int, now: float) -> bool:
        """Whether a picture may be compared or learnt, so that others need not be decoded."""
        known = self._views.get(view)
        return known is None or now - known.looked >= APART_S

    def look(self, picture: UInt8Array, view: int, now: float) -> None:
        """Take a picture (H, W, 3) RGB of daylight. `view`: where the camera looks, a number for each direction.

        Raises ImageError for another shape.
        """
        known = self._views.pop(view, None) or _View()
        self._views[view] = known  # the last of them now
        if len(self._views) > VIEWS:
            del self._views[next(iter(self._views))]
        known.looked = now
        reason = judge(picture).reason
        if reason is not None and reason is not Unusable.BLUR:
            return  # night, fog and glare are not the lens's
        seen = Detail.of(picture)
        if known.usual is not None and now - self._compared >= APART_S:
            self._compared = now
            median, spread, telling = known.usual
            change = seen.relative - median
            # Haze and light change the whole picture; drops leave most of it. Where nothing is sharp, all is lost.
            if reason is None and telling.any():
                change -= np.median(change[telling])
            self._lost.append(telling & (change < -np.maximum(_LOSS, _LOSS_SPREADS * spread)))
            self._known.append(telling)
            self._agree(now)
        if self.blurred.any():
            known.waiting.clear()
        elif reason is None:
            known.learn(seen, now)

    def said(self) -> str:
        """What is wrong with the lens, in words; empty: nothing."""
        if not self.blurred.any():
            return ""
        rows, columns = np.nonzero(self.blurred)
        upright = ("upper part", "middle", "lower part")[min(2, int(3 * (rows.mean() + 0.5) / ROWS))]
        across = ("left", "centre", "right")[min(2, int(3 * (columns.mean() + 0.5) / COLUMNS))]
        return (
            f"{self.blurred.mean():.0%} of the picture have lost their detail for {len(self._lost)} pictures, about "
            f"the {upright}, {across}: the lens is dirty or wet, clean it"
        )

    def _agree(self, now: float) -> None:
        if len(self._lost) < AGREEING:
            return
        lost, known = np.sum(self._lost, axis=0), np.sum(self._known, axis=0)
        share = np.where(known >= AGREEING // 2, lost / np.maximum(known, 1), 0.0)
        told = (share >= _OFTEN) | (self.blurred & (share >= _STILL))
        self.blurred = told if told.sum() >= _PARTS else np.zeros_like(told)
        if not self.blurred.any():
            self._since = None
            return
        self._since = now if self._since is None else self._since
        if now - self._since >= RELEARNT_AFTER_S:
            self._forget()


def _on_grid(values: Float32Array) -> Float32Array:
    return np.asarray(cv2.resize(values, (COLUMNS, ROWS), interpolation=cv2.INTER_AREA), np.float32)
