"""Detect smoke in front of the land: pixels that showed the land's pattern earlier and are now pale without it.

Smoke looks as a cloud or a pale slope does in one image, so each image is compared with earlier ones of the same
view. The land's pattern comes back under any exposure; in a cloud of smoke it does not. What is new on the land and
stays, a felled stand, say, looks like smoke too at first, but it has a pattern that comes back: from one remembered
image of it on, it is land again.

Images of another view, or of another light, do not agree with the present one and are ignored; if none agrees,
no smoke is reported.
The constants were set on pairs of photographs of two towers, one of them with smoke before land (docs/cameras.md)."""

from collections import deque
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.base.types import BoolArray, Float32Array, UInt8Array
from ltm_core.vision.labels import UNLABELLED, Label
from ltm_core.vision.network_image import shrunk, working_image

WORKING_WIDTH: Final = 320
APART_S: Final = 300.0  # seconds between two remembered images of a view, and minimum age of an image to compare with
AT_LEAST_APART_S: Final = 30.0  # seconds between any two remembered images, so that fog does not displace all others
OLDEST_S: Final = 10_800.0  # maximum age in seconds of an image to compare with; later, shadows have moved
REMEMBERED: Final = 36  # images: three hours of one view; of a patrol with more views, none is seen again in time
COMPARED: Final = 3  # number of best matching images to compare with

_COARSE: Final = 4  # reduction factor of the images by which a change of view is detected
_OF_A_VIEW: Final = 0.4
"""Correlation below which the view has changed. On photos of real towers hours apart, the same view has 0.9, and two
views of a tower have 0.42 at most, by their mast and caption."""
_REACH: Final = 3.3  # standard deviation in pixels of the Gaussian in which patterns are compared
_NOISE: Final = 0.5  # variance of grey levels due to noise and compression
_ALIKE: Final = 0.8  # correlation above which a pattern is unchanged
_AGREES: Final = 0.45  # minimum share of the land with unchanged patterns for one view and light
_GONE: Final = 0.5  # correlation below which a pattern is gone
_PATTERN: Final = 2.0  # minimum deviation in grey levels of the earlier image for a pattern to exist
_PALER: Final = 8.0  # grey levels by which smoke is brighter than what it hides
_LEAST: Final = 1e-3  # minimum share of the image of a smoke cloud
_WIDER: Final = 6  # pixels by which a detected cloud is enlarged


@dataclass(frozen=True, eq=False)
class _SmokeFrame:
    """An image at `at_s` seconds. `grey`: (h, w) uint8; `packed_land`: bits; `coarse`: its reduced pattern."""

    at_s: float
    grey: UInt8Array
    packed_land: UInt8Array
    coarse: Float32Array

    @classmethod
    def of(cls, picture: UInt8Array, labels: UInt8Array, at_s: float) -> Self:
        height, width = picture.shape[:2]
        size = min(WORKING_WIDTH, width), max(1, round(height * min(WORKING_WIDTH, width) / width))
        small = cv2.cvtColor(shrunk(working_image(picture), *size), cv2.COLOR_RGB2GRAY)
        cells = cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST_EXACT)
        land = (cells != Label.SKY) & (cells != UNLABELLED)
        fewer = max(1, size[0] // _COARSE), max(1, size[1] // _COARSE)
        whole = land.astype(np.float32)
        share, sums = (cv2.resize(of, fewer, interpolation=cv2.INTER_AREA) for of in (whole, whole * small))
        # Against the land around alone: the skylines of views look alike.
        pattern = np.where(share > 0, sums - share * _around(sums) / np.maximum(_around(share), 1e-3), 0)
        return cls(at_s, np.asarray(small, np.uint8), np.packbits(land), np.asarray(pattern, np.float32))

    @property
    def land(self) -> BoolArray:
        """Return (h, w) bool land."""
        return np.unpackbits(self.packed_land, count=self.grey.size).view(np.bool_).reshape(self.grey.shape)

    def may_be_view_of(self, other: "_SmokeFrame") -> bool:
        """Return whether both may be of one view: a first check, that of `_compare` is the one that counts."""
        if self.grey.shape != other.grey.shape:
            return False
        scale = float(np.linalg.norm(self.coarse) * np.linalg.norm(other.coarse))
        return scale > 0 and float((self.coarse * other.coarse).sum()) >= _OF_A_VIEW * scale


class SmokeMemory:
    """Recent views of a camera's land, by which smoke is detected in later images, in their order. Memory for
    `REMEMBERED` images is taken with the first one and used in turn: a camera must need in three hours what it needs at
    once, 2.9 MB for images of 16 to 9. Images of another size begin a new memory."""

    def __init__(self) -> None:
        self._seen: deque[_SmokeFrame] = deque(maxlen=REMEMBERED)
        self._slots = np.empty(0, np.uint8)
        self._next = 0

    def look(self, picture: UInt8Array, labels: UInt8Array, at_s: float) -> BoolArray | None:
        """Return (H, W) bool, where smoke hides the land in an image (H, W, 3) RGB taken at `at_s`; None: nowhere
        detectable. `labels`: (H, W), land is remembered. An image earlier than the last one is judged but not
        remembered; one hours earlier resets the memory, because a clock was set."""
        now = _SmokeFrame.of(picture, labels, at_s)
        if self._seen and at_s < self._seen[-1].at_s - OLDEST_S:
            self._seen.clear()
        found = self._hidden(now)
        if self._is_new(now):
            self._keep(now)
        if found is None or not found.any():
            return None
        size = picture.shape[1::-1]
        return np.asarray(cv2.resize(found.view(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0)

    def _is_new(self, now: _SmokeFrame) -> bool:
        """Return whether an image is new for its view; a patrol would otherwise be remembered in one view only."""
        if not self._seen or now.at_s - self._seen[-1].at_s < AT_LEAST_APART_S:
            return not self._seen
        return not any(s.may_be_view_of(now) for s in self._seen if now.at_s - s.at_s < APART_S)

    def _keep(self, now: _SmokeFrame) -> None:
        parts: dict[str, NDArray[Any]] = {"grey": now.grey, "packed_land": now.packed_land, "coarse": now.coarse}
        kind = np.dtype([(name, values.dtype, values.shape) for name, values in parts.items()])
        if self._slots.dtype != kind:
            self._seen.clear()
            self._slots = np.empty(REMEMBERED, kind)
            self._slots.view(np.uint8).fill(0)  # touched at once: memory that is only asked for comes page by page
        slot, self._next = self._slots[self._next], (self._next + 1) % REMEMBERED
        for name, values in parts.items():
            slot[name][...] = values
        self._seen.append(_SmokeFrame(now.at_s, slot["grey"], slot["packed_land"], slot["coarse"]))

    def _hidden(self, now: _SmokeFrame) -> BoolArray | None:
        could = [s for s in self._seen if APART_S <= now.at_s - s.at_s <= OLDEST_S and s.may_be_view_of(now)]
        if len(could) > 2 * COMPARED:  # as many as stay cheap: the newest, and others spread over the rest
            could = [could[k] for k in np.linspace(0, len(could) - 1, 2 * COMPARED).round().astype(int)]
        after = _pattern(now)
        pairs = [pair for s in could if (pair := _compare(s, after)) is not None]
        if not pairs:
            return None
        pairs = sorted(pairs, key=lambda pair: -pair.agrees)[:COMPARED]
        gone = np.max([pair.correlation for pair in pairs], axis=0) < _GONE
        pattern = np.max([np.where(pair.land, pair.deviation, 0) for pair in pairs], axis=0) > _PATTERN
        paler = np.max([np.where(pair.land, pair.brighter, -255) for pair in pairs], axis=0) > _PALER
        grey = cv2.GaussianBlur(now.grey, (0, 0), _REACH)
        land = np.logical_or.reduce([pair.land for pair in pairs])
        # What is darker than most of the land is no smoke, though a bush in the shade may have lost its pattern.
        dark = grey < np.median(grey[land])
        rough = (gone & pattern & paler & ~dark).astype(np.uint8)
        rough = cv2.morphologyEx(rough, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
        _, parts, statistics, _ = cv2.connectedComponentsWithStats(rough)
        large = statistics[:, cv2.CC_STAT_AREA] >= _LEAST * rough.size
        large[0] = False
        wider = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _WIDER + 1, 2 * _WIDER + 1))
        return np.asarray(cv2.dilate(large[parts].astype(np.uint8), wider) > 0)


class _Pattern(NamedTuple):
    """Grey levels of an image, and their mean and variance around each pixel: (h, w) each."""

    grey: Float32Array
    mean: Float32Array
    variance: Float32Array


def _pattern(seen: _SmokeFrame) -> _Pattern:
    grey = seen.grey.astype(np.float32)
    mean = _around(grey)
    return _Pattern(grey, mean, np.maximum(_around(grey * grey) - mean**2, 0))


class _Pair(NamedTuple):
    """The present image against an earlier one, (h, w) each. `correlation` of their patterns; `deviation`: how much
    pattern there was; `brighter`: grey levels, exposure left aside; `land`: there was. `agrees`: share of the land."""

    correlation: Float32Array
    deviation: Float32Array
    brighter: Float32Array
    land: BoolArray
    agrees: float


def _compare(earlier: _SmokeFrame, after: _Pattern) -> _Pair | None:
    """Compare patterns; None where they do not agree: another view, another light, or all in smoke."""
    land, before = earlier.land, _pattern(earlier)
    shared = _around(before.grey * after.grey) - before.mean * after.mean
    correlation = shared / np.sqrt((before.variance + _NOISE) * (after.variance + _NOISE))
    same = (correlation > _ALIKE) & land
    agrees = float(same.sum() / max(land.sum(), 1))
    if agrees < _AGREES:
        return None
    x, y = before.mean[same], after.mean[same]
    spread = float(x.var())
    gain = float(((x - x.mean()) * (y - y.mean())).mean() / spread) if spread > 1.0 else 1.0
    brighter = np.asarray(after.mean - (y.mean() + gain * (before.mean - x.mean())), np.float32)
    return _Pair(np.asarray(correlation, np.float32), np.sqrt(before.variance), brighter, land, agrees)


def _around(values: Float32Array) -> Float32Array:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), _REACH), np.float32)
