"""Rendered pixels on which fusion has to choose, with what it knows of them and what is true.

Two choices: does something stand before the ground, where the network sees it nearer? Is bare ground what shows, or the
canopy raster? Each sample has the quantities that fusion's log odds are
sums of, so that logistic regression finds their weights.
"""

from typing import NamedTuple

import cv2
import numba
import numpy as np

from ltm_core.base.types import BoolArray, Float32Array, Float64Array, UInt8Array
from ltm_core.depth.error_model import expected_prediction
from ltm_core.depth.expected_surface import FusionSettings, fitted
from ltm_core.depth.fusion_config import ClassLogOdds, FusionConfig
from ltm_core.depth.ground_sampling import ClassPriors, LabelView
from ltm_core.depth.guided_upsampling import NetworkView, upsample_row
from ltm_core.depth.monocular import NetworkDepth
from ltm_core.depth.occlusion_boundaries import refine_occlusion_boundaries
from ltm_core.depth.occlusion_prior import OcclusionPrior, ground_contact, height_above
from ltm_core.depth.pixel_fusion import DecisionRules, FusionRow, begin_row, compare_row, log_against
from ltm_core.geometry.range_image import DepthImage, RangeImage
from ltm_core.vision.labels import LabelSet

CLASSES = tuple(ClassLogOdds.model_fields)
"""Columns of the class features, `unlabelled` last."""
_FARTHEST = 1e5


class Samples(NamedTuple):
    """`features`: (N, F), weighted sums of which are log odds. `offset`: (N,) log odds that are not fitted. `right`:
    (N,) bool, what was asked is so."""

    features: Float64Array
    offset: Float64Array
    right: BoolArray


class FrameSamples(NamedTuple):
    """Of one frame. Features of `standing`: class shares, -height, -log likelihood of the terrain; of
    `canopy`: class, log likelihood of the canopy."""

    standing: Samples
    canopy: Samples


def frame_samples(
    traced: RangeImage | DepthImage,
    network: NetworkDepth,
    rgb: UInt8Array,
    labels: UInt8Array,
    true: Float32Array,
    over: Float32Array | None,
    label_set: LabelSet,
    settings: FusionSettings,
    config: FusionConfig,
) -> FrameSamples | None:
    """Samples of a frame; None where its network is of no use.

    `true`: (h, w) depth of what is seen, of every n-th pixel from the first; `over`: (H, W) of a canopy raster.
    """
    classes = ClassPriors.of(label_set, config)
    seen, spread, fit = fitted(traced, network, labels, classes, settings, config)
    if fit is None or fit.trouble:
        return None
    ground, step = traced.depth(), round(rgb.shape[1] / true.shape[1])
    view = NetworkView.of(fit, rgb, config)
    standing = OcclusionPrior.of(ground, labels, classes, traced.camera, traced.pose, view.cells.shape[1:], config)
    ids = np.array([label_set.id_of(name) for name in CLASSES[:-1]])
    depth, sigma = seen.copy(), spread.copy()
    refine_occlusion_boundaries(rgb, depth, sigma, ground, labels, classes, traced.camera, config)
    return FrameSamples(
        _standing(depth, sigma, view, standing, labels, ids, classes, true, step, config),
        _empty(len(CLASSES) + 1) if over is None else _canopy(seen, spread, over, view, labels, ids, true, step),
    )


def _shares(labels: UInt8Array, ids: UInt8Array, sky: int, cells: tuple[int, int]) -> Float32Array:
    """(h, w, C) of each class in the label of a place, as `OcclusionPrior` hears it; zeros for the sky."""
    small = cv2.resize(labels, cells[::-1], interpolation=cv2.INTER_NEAREST)
    masks = [small == i for i in ids]
    masks.append((small != sky) & ~np.any(masks, axis=0))
    return np.stack(masks, axis=-1).astype(np.float32)


def _standing(
    depth: Float32Array,
    sigma: Float32Array,
    view: NetworkView,
    prior: OcclusionPrior,
    labels: UInt8Array,
    ids: UInt8Array,
    classes: ClassPriors,
    true: Float32Array,
    step: int,
    config: FusionConfig,
) -> Samples:
    rules, seen = DecisionRules.of(config.decision), LabelView.of(labels, classes)
    found = _disagreements(depth, sigma, view, prior, seen, true, step, rules)
    row, col, height, against, other, terrain, truth = found.T
    shares = _shares(labels, ids, classes.sky, prior.odds.shape)
    place = shares[
        (row * prior.odds.shape[0] // depth.shape[0]).astype(int),
        (col * prior.odds.shape[1] // depth.shape[1]).astype(int),
    ]
    numbers = np.stack([-np.minimum(height, config.occlusion.highest), -against], axis=1)
    right = np.abs(np.log(truth / other)) < np.abs(np.log(truth / np.maximum(terrain, 1 / _FARTHEST)))
    features = np.concatenate([place, numbers], axis=1).astype(np.float64)
    return Samples(features, np.zeros(len(right)), right)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _disagreements(
    depth: Float32Array,
    sigma: Float32Array,
    view: NetworkView,
    prior: OcclusionPrior,
    labels: LabelView,
    truth: Float32Array,
    step: int,
    rules: DecisionRules,
) -> Float64Array:
    """(N, 7) of the pixels with truth where the network sees something nearer than the terrain, as `pixel_fusion` asks
    of them: row, column, height, log likelihood of the terrain, inverse depth of the thing, of the terrain and in
    truth."""
    width = depth.shape[1]
    errors, odds, feet = view.errors, prior.odds, prior.feet
    seen, between = np.empty((3, width), np.float32), np.empty((4, view.cells.shape[2]), np.float32)
    work, asked = np.empty((6, width), np.float32), np.zeros(width, np.bool_)
    unlabelled, kind = np.full(width, np.uint8(255)), np.empty(width, np.uint8)
    found, n = np.empty((truth.size, 7), np.float64), 0
    for k in range(truth.shape[0]):
        v = k * step
        d, s = depth[v].copy(), sigma[v].copy()
        label = labels.ids[v] if labels.known else unlabelled
        row = FusionRow(
            d, s, kind, label, seen[0], seen[1], seen[2], work[0], work[1], work[2], work[3], work[4], work[5], asked
        )
        upsample_row(view, v, between, seen)
        begin_row(d, s, kind)
        compare_row(row, errors, labels.sky, rules)
        for m in range(truth.shape[1]):
            u, t = m * step, truth[k, m]
            if not (asked[u] and kind[u] > 0 and row.off[u] > 0 and t > 0 and t < np.float32(1e9)):
                continue
            edge = (row.nearest[u] - row.seen[u]) / row.off[u]
            other = row.seen[u]
            if not (edge < np.float32(1.0) and other > 0):
                continue
            below = feet[u * odds.shape[1] // width]
            foot = ground_contact(other, below, v)
            out = found[n]
            out[0], out[1], out[2] = v, u, height_above(prior, other, v, foot)
            out[3] = log_against(other, row.off[u], row.joint[u], row.spread[u], view.gross, rules)
            out[4], out[5], out[6] = other, row.true[u], 1.0 / t
            n += 1
    return found[:n]


def _canopy(
    depth: Float32Array,
    sigma: Float32Array,
    over: Float32Array,
    view: NetworkView,
    labels: UInt8Array,
    ids: UInt8Array,
    truth: Float32Array,
    step: int,
) -> Samples:
    found = _two_surfaces(depth, sigma, over, view, truth, step)
    row, col, for_over, ground, top, true = found.T
    true, ground = np.minimum(true, _FARTHEST), np.minimum(ground, _FARTHEST)
    right = np.abs(np.log(true / top)) < np.abs(np.log(true / ground))
    features = np.concatenate([_one_hot(labels[row.astype(int), col.astype(int)], ids), for_over[:, None]], axis=1)
    return _part(features, np.zeros(len(right)), right, np.isfinite(for_over))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _two_surfaces(
    depth: Float32Array, sigma: Float32Array, over: Float32Array, view: NetworkView, truth: Float32Array, step: int
) -> Float64Array:
    """(N, 6) of pixels with truth where a canopy raster and the ground differ: row, column, log likelihood of the
    canopy, depth of the ground, of the canopy, truth."""
    errors = view.errors
    found, n = np.empty((truth.size, 6), np.float64), 0
    seen, between = np.empty((3, over.shape[1]), np.float32), np.empty((4, view.cells.shape[2]), np.float32)
    for k in range(truth.shape[0]):
        upsample_row(view, k * step, between, seen)
        for m in range(truth.shape[1]):
            v, u, t = k * step, m * step, truth[k, m]
            c, d = over[v, u], depth[v, u]
            if not (c < np.float32(1e9) and t > 0 and (not d < np.float32(1e9) or abs(c - d) > sigma[v, u])):
                continue
            y, a = seen[0, u], np.float32(0.0)
            if d < np.float32(1e9):
                a = np.float32(1.0) / d
            less, spread = expected_prediction(a, errors)
            off = (y - a + less) / spread
            gain = 0.5 * off * off + np.log(spread)
            less, spread = expected_prediction(np.float32(1.0) / c, errors)
            off = (y - np.float32(1.0) / c + less) / spread
            out = found[n]
            out[0], out[1], out[2] = v, u, gain - 0.5 * off * off - np.log(spread)
            out[3], out[4], out[5] = d if d < np.float32(1e9) else np.float32(1e9), c, t
            n += 1
    return found[:n]


def _one_hot(labels: UInt8Array, ids: UInt8Array) -> Float64Array:
    known = labels[:, None] == ids[None, :]
    return np.concatenate([known, ~known.any(axis=1, keepdims=True)], axis=1).astype(np.float64)


def _part(features: Float64Array, offset: Float64Array, right: BoolArray, chosen: BoolArray) -> Samples:
    return Samples(features[chosen], offset[chosen], right[chosen])


def _empty(columns: int) -> Samples:
    return Samples(np.empty((0, columns)), np.empty(0), np.empty(0, np.bool_))
