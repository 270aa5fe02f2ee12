"""Fit a network's depth to metres: a robust line over the image, then slow corrections.

RANSAC (Fischler and Bolles, 1981) with the median as its score (LMedS, Rousseeuw, 1984), so that the noise need not be
known, and least squares over the inliers; all trials are scored in one array operation. The result is inverse depth,
1/m, whose noise is about even over the image."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Float64Array
from ltm_core.depth.error_model import ErrorModel, estimate_errors, octaves
from ltm_core.depth.fusion_config import FusionConfig, RegressionConfig
from ltm_core.depth.ground_sampling import GroundSamples
from ltm_core.depth.monocular import NetworkDepth


@dataclass(frozen=True, eq=False)
class Line:
    """Line y = scale x + shift, with `sigma`, the robust standard deviation of its inliers (of weighted residuals), and
    the mask of `inliers`, (N,) bool."""

    scale: float
    shift: float
    sigma: float
    inliers: BoolArray


def robust_line(
    x: Float64Array, y: Float64Array, weights: Float64Array, floor: float, rules: RegressionConfig
) -> Line | None:
    """Return the line through the points (N,) that at most half of them contradict; None for fewer than `rules.fewest`
    points or constant x. `weights`: (N,) factors of the residuals. `floor`: minimum sigma of a weighted residual."""
    if len(x) < rules.fewest or not np.ptp(x) > 1e-9 * max(1.0, float(np.abs(x).max())):
        return None
    rng = np.random.default_rng(0)
    first, second = rng.integers(0, len(x), (2, rules.trials))
    run = x[second] - x[first]
    usable = np.abs(run) > rules.least_run * np.ptp(x)
    if not usable.any():
        return None
    first, second, run = first[usable], second[usable], run[usable]
    scales = (y[second] - y[first]) / run
    shifts = y[first] - scales * x[first]
    scored = slice(None, None, max(1, len(x) // rules.scored))
    # Single precision will do to tell the best trial: it is refined below.
    trial = (scales[:, None].astype(np.float32), shifts[:, None].astype(np.float32))
    points = (x[scored].astype(np.float32), y[scored].astype(np.float32), weights[scored].astype(np.float32))
    residuals = np.abs(trial[0] * points[0] + trial[1] - points[1]) * points[2]
    half = residuals.shape[1] // 2
    medians = np.partition(residuals, half, axis=1)[:, half]
    best = int(np.argmin(medians))
    scale, shift = float(scales[best]), float(shifts[best])
    for _ in range(rules.refined):
        sigma, inliers = _inliers(np.abs(scale * x + shift - y) * weights, floor, rules)
        if inliers.sum() < rules.fewest or not np.ptp(x[inliers]) > 0:
            break
        w = weights[inliers]
        design = np.stack([x[inliers] * w, w], axis=1)
        (scale, shift), *_ = np.linalg.lstsq(design, y[inliers] * w, rcond=None)
    off = np.abs(scale * x + shift - y) * weights
    return Line(float(scale), float(shift), sigma, off <= rules.band * sigma)


def robust_offset(values: Float64Array, floor: float, rules: RegressionConfig) -> Line | None:
    """Return the centre of most of `values` (N,), the middle of their densest half, as a line of scale 1."""
    if len(values) < rules.fewest:
        return None
    ordered = np.sort(values)
    half = (len(ordered) + 1) // 2
    start = int(np.argmin(ordered[half - 1 :] - ordered[: len(ordered) - half + 1]))
    shift, sigma = float(np.median(ordered[start : start + half])), floor
    for _ in range(rules.refined):
        sigma, inliers = _inliers(np.abs(values - shift), floor, rules)
        shift = float(values[inliers].mean())
    return Line(1.0, shift, sigma, np.abs(values - shift) <= rules.band * sigma)


def _inliers(off: Float64Array, floor: float, rules: RegressionConfig) -> tuple[float, BoolArray]:
    """Return the robust sigma of residuals (N,), and which of them are within the band."""
    inliers, sigma = np.ones(len(off), np.bool_), floor
    for _ in range(2):  # among outliers the median overstates the noise; that of the inliers does not
        sigma = max(1.4826 * float(np.median(off[inliers])), floor)
        inliers = np.asarray(off <= rules.band * sigma)
    return sigma, inliers


@dataclass(frozen=True, eq=False)
class ScaleFit:
    """Inverse depth of a network in 1/m at its own size, with the quality of its fit.

    `inverse`: (h, w) float32, 1/m, by one scale and shift. `nearest`, `farthest`: the same, the greatest and the least
    among a pixel's neighbours: edges are soft, and halfway is neither side's depth. `error_model`: what it says where
    the truth is known. `gross`: share of answers that are no noise but wrong. `line`: scale and shift, in the measure
    of the network's kind. `trouble`: why the fit cannot be used; empty where it can."""

    inverse: Float32Array
    nearest: Float32Array
    farthest: Float32Array
    error_model: ErrorModel
    gross: float
    line: Line | None
    trouble: str


def fit_scale(network: NetworkDepth, samples: GroundSamples, size: tuple[int, int], config: FusionConfig) -> ScaleFit:
    """Fit a network's depth to ground samples of a photo of `size` (height, width)."""
    values, rules = network.values, config.scale
    trouble = _unfit(values, network.kind)
    if not trouble and len(samples) < rules.least_samples:
        trouble = f"{len(samples)} pixels of trustworthy ground are too few to fit a scale"
    if trouble:
        return _unusable(network, None, trouble)
    at = sampled(values, samples, size)
    known = np.isfinite(at)
    if known.sum() < rules.least_samples:
        return _unusable(network, None, f"{int(known.sum())} of {len(samples)} ground samples have a network depth")
    line = fitted_line(network.kind, at[known], samples.part(known), config)
    if line is None:
        return _unusable(network, None, "the network's depth is constant over the ground samples")
    if (inliers := float(line.inliers.mean())) < rules.least_inliers:
        return _unusable(network, line, f"only {inliers:.0%} of the ground samples fit one scale and shift")
    if line.scale <= 0:
        return _unusable(network, line, f"the network's depth is opposite to the terrain's (scale {line.scale:.3g})")
    inverse = _in_metres(network, line)
    read = sampled(inverse, samples, size)
    explained = _explained(1.0 / samples.depth, read)
    if explained < rules.least_explained and line.sigma > rules.like_terrain:
        return _unusable(network, line, f"the network's depth explains only {explained:.0%} of the terrain's")
    model = estimate_errors(read, samples, size, config)
    # Ground seldom vanishes, so what is farther than the terrain is an error; what is nearer may be plants as well.
    near = octaves(samples.depth)
    off = 1.0 - read * samples.depth - model.shift[near]
    joint = off / np.hypot(model.factor[near], samples.sigma / samples.depth)  # in sigmas of network and terrain
    joint = joint[np.isfinite(joint)]
    gross = float(np.mean(joint > rules.gross_sigmas) + rules.covered_gross * np.mean(joint < -rules.gross_sigmas))
    gross = max(gross, rules.least_gross, min(line.sigma, rules.noisy_gross))
    plain, square = np.nan_to_num(inverse, nan=0.0), np.ones((3, 3), np.uint8)
    nearest, farthest = (np.asarray(of(plain, square), np.float32) for of in (cv2.dilate, cv2.erode))
    return ScaleFit(inverse, nearest, farthest, model, gross, line, "")


def sampled(image: Float32Array, samples: GroundSamples, size: tuple[int, int]) -> Float64Array:
    """Return an image (h, w) over the same field of view at the samples' pixels, bilinear, (N,) float64."""
    height, width = image.shape
    x = (samples.cols + 0.5) * (width / size[1]) - 0.5
    y = (samples.rows + 0.5) * (height / size[0]) - 0.5
    x, y = np.clip(x, 0, width - 1.001), np.clip(y, 0, height - 1.001)
    c, r = x.astype(np.intp), y.astype(np.intp)
    fx, fy = x - c, y - r
    upper = image[r, c] * (1 - fx) + image[r, c + 1] * fx
    lower = image[r + 1, c] * (1 - fx) + image[r + 1, c + 1] * fx
    return np.asarray(upper * (1 - fy) + lower * fy, np.float64)


def _unfit(values: Float32Array, kind: str) -> str:
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


def fitted_line(kind: str, values: Float64Array, samples: GroundSamples, config: FusionConfig) -> Line | None:
    """Fit scale and shift. Residuals of inverse depth are weighted in proportion to it in the near range, evenly in the
    far range, and less where the terrain is uncertain."""
    rules, floor = config.regression, config.scale.relative_floor
    inverse = 1.0 / samples.depth
    unsure = np.hypot(1.0, samples.sigma / samples.depth / config.scale.typical_sigma)
    if kind == "affine_invariant":
        return robust_line(values, samples.depth, inverse / unsure, floor, rules)
    positive = values > 0
    if kind == "metric":
        line = robust_offset(np.log(samples.depth[positive]) - np.log(values[positive]), floor, rules)
        if line is not None:
            inliers = np.zeros(len(values), np.bool_)
            inliers[positive] = line.inliers
            line = replace(line, inliers=inliers)
        return line
    weight = 1.0 / (np.hypot(inverse, np.median(inverse)) * unsure)

    def line_of(scale: float, shift: float) -> Line:
        off = np.abs(scale * values + shift - inverse) * weight
        sigma = max(1.4826 * float(np.median(off)), floor)
        return Line(scale, shift, sigma, off <= rules.band * sigma)

    # First without a shift, unless the network often gives less than 0.
    plain = None
    if positive.mean() >= config.scale.least_positive:
        ratio = robust_offset(np.log(inverse[positive]) - np.log(values[positive]), floor, rules)
        plain = None if ratio is None else line_of(float(np.exp(ratio.shift)), 0.0)
    # A shift determines all far depths, so it must reduce the residuals enough. The network's values are regressed on
    # the terrain's, because the network is the noisy side.
    reach, spread = (float(np.subtract(*np.quantile(these, (0.9, 0.1)))) for these in (inverse, values))
    back = robust_line(inverse, values, weight, floor * spread / max(reach, 1e-12), rules)
    if back is None or (back.scale <= 0 and plain is not None):
        return plain
    if back.scale == 0:
        return None
    shifted = line_of(1.0 / back.scale, -back.shift / back.scale)
    if plain is None:
        return shifted
    before, after = (float(np.median(np.abs(x.scale * values + x.shift - inverse) * weight)) for x in (plain, shifted))
    gain = config.scale.shift_gain
    fewer = after < gain * before and after / abs(shifted.scale) < gain * before / abs(plain.scale)
    return shifted if fewer else plain


def _explained(inverse: Float64Array, fitted: Float64Array) -> float:
    """Return the part of the ground's spread in inverse depth, in proportion to it, that `fitted` takes away: a mean of
    what is cut off at 1, since few samples may be all that lie at another depth."""
    usable = np.isfinite(fitted)
    inverse, fitted = inverse[usable], fitted[usable]
    middle = np.median(inverse)
    typical = np.hypot(inverse, middle)
    before, after = (float(np.mean(np.minimum(np.abs(inverse - to) / typical, 1.0))) for to in (middle, fitted))
    return 1.0 - after / max(before, 1e-12)


def _in_metres(network: NetworkDepth, line: Line) -> Float32Array:
    """Return the inverse depth, 1/m; NaN where the line leads below 0 depth."""
    values = network.values
    if network.kind == "relative_inverse":
        return (line.scale * values + line.shift).astype(np.float32)
    with np.errstate(divide="ignore", invalid="ignore"):
        if network.kind == "affine_invariant":
            depth = line.scale * values + line.shift
        else:
            depth = np.where(values > 0, values, np.nan) * np.exp(line.shift)
        return np.where(depth > 0, 1.0 / depth, np.nan).astype(np.float32)


def _unusable(network: NetworkDepth, line: Line | None, trouble: str) -> ScaleFit:
    nothing = np.full(network.values.shape, np.nan, np.float32)
    return ScaleFit(nothing, nothing, nothing, ErrorModel.none(), 1.0, line, trouble)
