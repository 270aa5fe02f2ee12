"""A network's depth brought to metres: one line over the image, then slow corrections where they hold on unseen ground.

Everything ends as inverse depth, 1/m, since that is what a photo determines: its noise is then about even over the
image, and far is 0 and not infinite.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ltm_core.depth.monocular import NetworkDepth
from ltm_core.depth.regression import Line, robust_line, robust_offset
from ltm_core.depth.sampling import GroundSamples

Floats = NDArray[np.float64]
Image = NDArray[np.float32]

LEAST_INLIERS = 0.3
"""Share of samples below which nothing holds together."""
LEAST_EXPLAINED = 0.2
"""Part of the ground's robust spread in inverse depth that a network must take away to be of use."""
REGIONS = (9, 16)
"""Rows and columns of the field of slow corrections."""
_SHRINK = (4.0, 16.0, 64.0)  # samples' worth of belief in no correction, tried in turn
_GAIN = 0.97  # of the held-out error: corrections that do not reach it are left out
_RELATIVE_FLOOR = 2e-3  # least relative noise of a fit that is believed
_WINSOR = 6.0
_COVERED = 4.0
TAIL, TAIL_SIGMAS = 0.99, 2.576
"""A normal distribution's share of residuals within so many sigmas."""
UNSAMPLED = 4.0
"""Variance of a region without samples, in that of regions held out."""


@dataclass(frozen=True, eq=False)
class NetworkFit:
    """A network's inverse depth in 1/m at its own size, and what the fit says of it.

    `inverse`, `sigma`: (h, w) float32, 1/m; sigma is so large that on trusted ground one residual in 100 lies beyond
    2.6 of it, as of a normal distribution, though a network's errors have long tails. `step`: (h, w) float32, 1/m, how
    far `inverse` ranges among a pixel's neighbours: edges are soft, and halfway is neither side's depth. `line`: scale
    and shift, in the measure of the network's kind. `regional`: whether slow corrections are in. `trouble`: why the fit
    cannot be used; empty where it can.
    """

    inverse: Image
    sigma: Image
    step: Image
    line: Line | None
    regional: bool
    trouble: str

    @property
    def inlier_ratio(self) -> float:
        return 0.0 if self.line is None else self.line.inlier_ratio


def fit_network(network: NetworkDepth, samples: GroundSamples, size: tuple[int, int]) -> NetworkFit:
    """Fit a network's depth to ground samples of a photo of `size` (height, width)."""
    values = network.values
    trouble = _unfit(values, network.kind) or _too_few(samples)
    if trouble:
        return _unusable(network, None, trouble)
    at = sampled(values, samples, size)
    known = np.isfinite(at)
    if known.sum() < 50:
        return _unusable(network, None, f"{int(known.sum())} of {len(samples)} ground samples have a network depth")
    line = _line(network.kind, at[known], samples.depth[known])
    if line is None:
        return _unusable(network, None, "the network's depth is constant over the ground samples")
    if line.inlier_ratio < LEAST_INLIERS:
        return _unusable(network, line, f"only {line.inlier_ratio:.0%} of the ground samples fit one scale and shift")
    if line.scale <= 0:
        return _unusable(network, line, f"the network's depth runs against the terrain's (scale {line.scale:.3g})")
    inverse = _in_metres(network, line)
    noise = _noise(1.0 / samples.depth, 1.0 / samples.depth - sampled(inverse, samples, size))
    if network.kind == "relative_inverse":
        again = robust_line(
            at[known], 1.0 / samples.depth[known], 1.0 / noise.of(1.0 / samples.depth[known]).astype(np.float64)
        )
        if again is not None and again.scale > 0:
            line, inverse = replace(again, inliers=line.inliers), _in_metres(network, again)
            noise = _noise(1.0 / samples.depth, 1.0 / samples.depth - sampled(inverse, samples, size))
    explained = _explained(1.0 / samples.depth, sampled(inverse, samples, size))
    if explained < LEAST_EXPLAINED:
        return _unusable(network, line, f"the network's depth explains only {explained:.0%} of the terrain's")
    sigma = noise.of(inverse)
    here, spread = sampled(inverse, samples, size), sampled(sigma, samples, size)
    off = 1.0 / samples.depth - here
    terrain = samples.sigma / samples.depth**2
    usable = np.isfinite(off) & np.isfinite(spread)
    field, factor = _regional(off / spread, usable, samples, size)
    if field is not None:
        inverse = inverse + sigma * _grown(field, inverse.shape)
        off = 1.0 / samples.depth - sampled(inverse, samples, size)
    sigma = (sigma * _grown(factor, sigma.shape)).astype(np.float32)
    joint = (off / np.hypot(sampled(sigma, samples, size), terrain))[usable]
    # Only where the network sees something farther than the terrain: there it errs, since ground seldom vanishes.
    # What it sees nearer may be plants that no label told of.
    farther = joint[joint > 0]
    tail = float(np.quantile(farther, TAIL)) if len(farther) >= 20 else 0.0
    sigma = (sigma * max(1.0, tail / TAIL_SIGMAS)).astype(np.float32)
    return NetworkFit(inverse.astype(np.float32), sigma, _range(inverse), line, field is not None, "")


def sampled(image: Image, samples: GroundSamples, size: tuple[int, int]) -> Floats:
    """An image (h, w) over the same field of view at the samples' pixels, bilinear, (N,) float64."""
    height, width = image.shape
    x = (samples.cols + 0.5) * (width / size[1]) - 0.5
    y = (samples.rows + 0.5) * (height / size[0]) - 0.5
    x, y = np.clip(x, 0, width - 1.001), np.clip(y, 0, height - 1.001)
    c, r = x.astype(np.intp), y.astype(np.intp)
    fx, fy = x - c, y - r
    upper = image[r, c] * (1 - fx) + image[r, c + 1] * fx
    lower = image[r + 1, c] * (1 - fx) + image[r + 1, c + 1] * fx
    return np.asarray(upper * (1 - fy) + lower * fy, np.float64)


def _unfit(values: Image, kind: str) -> str:
    known = np.isfinite(values)
    if kind == "metric":
        known &= values > 0
    share = float(known.mean())
    if share < 0.5:
        return f"the network gives no depth for {1 - share:.0%} of its pixels"
    low, high = np.quantile(values[known], (0.01, 0.99))
    if not high - low > 1e-6 * max(abs(float(low)), abs(float(high)), 1e-12):
        return f"the network gives the same depth everywhere ({float(low):.4g})"
    return ""


def _too_few(samples: GroundSamples) -> str:
    return "" if len(samples) >= 50 else f"{len(samples)} pixels of trustworthy ground are too few to fit a scale to"


def _line(kind: str, values: Floats, depth: Floats) -> Line | None:
    if kind == "relative_inverse":
        return robust_line(values, 1.0 / depth, floor=_RELATIVE_FLOOR / float(np.median(depth)))
    if kind == "affine_invariant":
        return robust_line(values, depth, weight=1.0 / depth, floor=_RELATIVE_FLOOR)
    return robust_offset(np.log(depth) - np.log(values), floor=_RELATIVE_FLOOR)


@dataclass(frozen=True, eq=False)
class _Noise:
    """Sigma of inverse depth as it grows with inverse depth itself: `sigma` (K,) at `inverse` (K,), 1/m."""

    inverse: Floats
    sigma: Floats

    def of(self, inverse: NDArray[np.floating]) -> Image:
        # Nearer than all samples: in proportion, for nothing is known of it.
        beyond = np.maximum(inverse / self.inverse[-1], 1.0)
        sigma: Image = (np.interp(inverse, self.inverse, self.sigma) * beyond).astype(np.float32)
        return sigma


def _noise(inverse: Floats, off: Floats) -> _Noise:
    """Robust spread of `off` (N,) in eight parts of equal count from far to near, never falling towards the near."""
    usable = np.isfinite(off)
    order = np.argsort(inverse[usable])
    parts = np.array_split(order, 8)
    centre = np.array([np.median(inverse[usable][part]) for part in parts])
    spread = np.array([1.4826 * np.median(np.abs(off[usable][part])) for part in parts])
    return _Noise(centre, np.maximum(np.maximum.accumulate(spread), _RELATIVE_FLOOR * centre))


def _explained(inverse: Floats, fitted: Floats) -> float:
    usable = np.isfinite(fitted)
    before = np.median(np.abs(inverse[usable] - np.median(inverse[usable])))
    return 1.0 - float(np.median(np.abs(inverse[usable] - fitted[usable])) / max(before, 1e-12))


def _in_metres(network: NetworkDepth, line: Line) -> Image:
    """Inverse depth, 1/m; NaN where the line leads below 0 depth."""
    values = network.values
    if network.kind == "relative_inverse":
        return (line.scale * values + line.shift).astype(np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        if network.kind == "affine_invariant":
            depth = line.scale * values + line.shift
        else:
            depth = np.where(values > 0, values, np.nan) * np.exp(line.shift)
        return np.where(depth > 0, 1.0 / depth, np.nan).astype(np.float32)


def _regional(
    off: Floats, usable: NDArray[np.bool_], samples: GroundSamples, size: tuple[int, int]
) -> tuple[Image | None, Image]:
    """The field of slow corrections in sigmas, or None where it does not help, and the sigmas' local factor, (R, C).

    A field is taken over the regions of a checkerboard and judged on the others: what a correction says of ground that
    it has not seen is what it will say of trees.
    """
    # What the network sees much nearer than the terrain is cover that no label told of, not its slow error.
    usable = usable & ~(off < -_COVERED)
    rows = np.minimum((samples.rows * REGIONS[0]) // size[0], REGIONS[0] - 1)[usable]
    cols = np.minimum((samples.cols * REGIONS[1]) // size[1], REGIONS[1] - 1)[usable]
    off = np.clip(off[usable], -_WINSOR, _WINSOR)
    index, black = rows * REGIONS[1] + cols, (rows + cols) % 2 == 0
    unseen = float(np.mean(off**2))
    best, shrink = unseen * _GAIN**2, None
    for belief in _SHRINK:
        left = np.concatenate(
            [(off - _field(index[s], off[s], belief).ravel()[index])[~s] for s in (black, ~black) if s.any()]
        )
        if len(left) and float(np.mean(left**2)) < best:
            unseen = best = float(np.mean(left**2))
            shrink = belief
    field = None if shrink is None else _field(index, off, shrink)
    if field is not None:
        off = off - field.ravel()[index]
    # Where no ground was sampled, errors are those of regions that were held out, and more: these lay side by side.
    spread = np.sqrt(_field(index, off**2, 16.0, max(1.0, UNSAMPLED * unseen)))
    return field, spread


def _field(index: NDArray[np.intp], off: Floats, belief: float, prior: float = 0.0) -> Image:
    """Smoothed mean of `off` by region (R, C), drawn towards `prior` by as many samples as `belief` says."""
    cells = REGIONS[0] * REGIONS[1]
    totals = np.bincount(index, off - prior, cells).reshape(REGIONS).astype(np.float32)
    counts = np.bincount(index, minlength=cells).reshape(REGIONS).astype(np.float32)
    totals, counts = (cv2.GaussianBlur(a, (0, 0), 1.0, borderType=cv2.BORDER_REPLICATE) for a in (totals, counts))
    return np.asarray(prior + totals / (counts + belief), np.float32)


def _range(image: Image) -> Image:
    """Largest minus least value among each pixel's neighbours."""
    known = np.nan_to_num(image, nan=0.0)
    square = np.ones((3, 3), np.uint8)
    return np.asarray(cv2.dilate(known, square) - cv2.erode(known, square), np.float32)


def _grown(field: Image, shape: tuple[int, ...]) -> Image:
    return np.asarray(cv2.resize(field, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), np.float32)


def _unusable(network: NetworkDepth, line: Line | None, trouble: str) -> NetworkFit:
    nothing = np.full(network.values.shape, np.nan, np.float32)
    return NetworkFit(nothing, nothing, nothing, line, False, trouble)
