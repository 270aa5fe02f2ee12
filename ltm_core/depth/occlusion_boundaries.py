"""Move the edges between ridges to where the photo shows them, which is more accurate than the DEM.

The pixels above a traced silhouette are given to the near or the far side by colour: one cut a column where the
likelihood is greatest, under a prior that falls with the height of the cover. A fitted network's depth takes part."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import Float32Array, Int32Array, UInt8Array
from ltm_core.depth.error_model import ErrorModel, expected_prediction
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import ClassPriors, LabelView
from ltm_core.depth.guided_upsampling import NetworkView, upsample_pixel
from ltm_core.depth.occlusion_prior import DepthDiscontinuities, mixture_moments
from ltm_core.geometry.camera import Camera

_Answer = tuple[np.float32, np.float32, np.float32, np.float32]
"""True inverse depth, the network's bias and its sigma there (all in 1/m), and the logarithm of the sigma."""


class BoundaryRules(NamedTuple):
    """Compiled form of `BoundaryConfig`, with further values. `highest`: metres that each class may rise over a crest;
    `focal`: pixels; `jump`: ratio of depths between two surfaces; `open`: as in `DecisionRules`."""

    usual_crest: np.float32
    strip_px: int
    strip_cells: np.float32
    sample_rows: int
    sample_columns: int
    color_noise: np.float32
    temper: np.float32
    most: np.float32
    network_most: np.float32
    network_sure: np.float32
    need: np.float32
    toward: np.float32
    highest: np.float32
    focal: np.float32
    jump: np.float32
    open: np.float32
    sure: np.float32
    """The value 1 - open."""

    @classmethod
    def of(cls, config: FusionConfig, highest: float, focal: float) -> BoundaryRules:
        given: list[Any] = [getattr(config.boundaries, name) for name in cls._fields[:12]]
        opens = config.decision.open
        more: list[Any] = [np.float32(v) for v in (highest, focal, config.surface.jump, opens, 1.0 - opens)]
        compiled: list[Any] = [v if isinstance(v, int) else np.float32(v) for v in given]
        return cls(*compiled, *more)


def refine_occlusion_boundaries(
    rgb: UInt8Array,
    ground: Float32Array,
    surface: Float32Array,
    sigma: Float32Array,
    labels: UInt8Array | None,
    classes: ClassPriors,
    camera: Camera,
    config: FusionConfig,
    network: NetworkView | None = None,
    edges: DepthDiscontinuities | None = None,
) -> Int32Array:
    """Move the edges of `surface` and `sigma` (H, W), in place, to those of the photo; return by how many pixels (N,)
    the photo puts each of `edges` higher. `labels`: (H, W) ids of `classes`, or None. `network`: its view at the
    photo's size. `edges`: of `ground`, if known."""
    rules = config.boundaries
    edges = DepthDiscontinuities.of(ground, config.surface.jump) if edges is None else edges
    rows, cols = edges.rows, edges.cols
    color = np.asarray(cv2.blur(rgb, rules.blur), np.uint8) if len(rows) else rgb
    raised = np.zeros(len(rows), np.int32)
    view = NetworkView.none() if network is None else network
    seen = LabelView.of(labels, classes)
    highest = float(classes.crest[255] if labels is None and network is None else classes.crest.max())
    compiled = BoundaryRules.of(config, highest, camera.fy)
    _cut(color, ground, seen, classes.crest, view, compiled, rows, cols, raised)
    _raise(rows, cols, raised, ground, seen, classes.outline, view, compiled, surface, sigma)
    return raised


@helper()
def _sample(
    color: UInt8Array, top: int, bottom: int, u: int, rules: BoundaryRules, mean: Float32Array, var: Float32Array
) -> None:
    """Return the mean and variance (3,) of the colours in rows [top, bottom) about column u."""
    left, right = max(u - rules.sample_columns, 0), min(u + rules.sample_columns + 1, color.shape[1])
    count = np.float32((bottom - top) * (right - left))
    # In short whole numbers, for speed: floats would have to be added one after the other.
    red = green = blue = red_square = green_square = blue_square = np.int32(0)
    for v in range(top, bottom):
        line = color[v, left:right]
        for x in range(len(line)):
            r, g, b = np.int32(line[x, 0]), np.int32(line[x, 1]), np.int32(line[x, 2])
            red, red_square = np.int32(red + r), np.int32(red_square + r * r)
            green, green_square = np.int32(green + g), np.int32(green_square + g * g)
            blue, blue_square = np.int32(blue + b), np.int32(blue_square + b * b)
    mean[0], mean[1], mean[2] = np.float32(red), np.float32(green), np.float32(blue)
    var[0], var[1], var[2] = np.float32(red_square), np.float32(green_square), np.float32(blue_square)
    for j in range(3):
        mean[j] /= count
        var[j] = max(var[j] / count - mean[j] * mean[j], np.float32(0.0)) + rules.color_noise


@helper()
def _step(low: np.float32, high: np.float32, near: np.float32, far: np.float32) -> np.float32:
    """Return how far the network sees the terrain's step at an edge, 0 to 1: between what it gives surely below (`low`)
    and surely above (`high`), 1/m. Soft or displaced edges give values near 0."""
    share = (low - high) / (1 / near - (1 / far if far < 1e9 else np.float32(0.0)))
    return min(share, 1 / share) if share > 0 else np.float32(0.0)


@helper()
def _answer(depth: np.float32, errors: ErrorModel) -> _Answer:
    """Return what the network says of a surface of known `depth`, which may be inf."""
    true = np.float32(1.0) / depth
    less, spread = expected_prediction(true, errors)
    return true, less, spread, np.log(spread)


@helper()
def _against(inverse: np.float32, answer: _Answer) -> np.float32:
    """Return the log likelihood by which what the network sees, 1/m, speaks against a surface."""
    true, less, spread, log = answer
    off = (inverse - true + less) / spread
    return np.float32(0.5) * off * off + log


@helper()
def _farther(inverse: np.float32, near: _Answer, far: np.float32, errors: ErrorModel, most: np.float32) -> np.float32:
    """Return the network's log likelihood ratio of the far side, of depth `far`, to the near one."""
    if np.isnan(inverse) or np.isnan(far):
        return np.float32(0.0)
    gain = _against(inverse, near) - _against(inverse, _answer(far, errors))
    return min(max(gain, -most), most)


@kernel(nogil=True)
def _cut(
    color: UInt8Array,
    ground: Float32Array,
    labels: LabelView,
    crest: Float32Array,
    view: NetworkView,
    rules: BoundaryRules,
    rows: Int32Array,
    cols: Int32Array,
    raised: Int32Array,
) -> None:
    """Fill `raised`: by how many pixels the photo has each edge higher."""
    height = color.shape[0]
    near, near_var = np.empty(3, np.float32), np.empty(3, np.float32)
    far, far_var = np.empty(3, np.float32), np.empty(3, np.float32)
    errors, ids, labelled, sky = view.errors, labels.ids, labels.known, labels.sky
    sample, focal, jump, sure = rules.sample_rows, rules.focal, rules.jump, rules.network_sure
    most = rules.strip_px
    if view.there:
        most = min(most, int(np.ceil(rules.strip_cells * np.float32(height) / view.cells.shape[1])))
    for i in range(len(rows)):
        v: Any = np.int64(rows[i])  # else what takes them is compiled for each width
        u: Any = np.int64(cols[i])
        d = ground[v, u]
        # The widest strip that any class allows decides where the far side's colour is taken; for most columns
        # no pixel is of a tall class and the usual crest's strip will do.
        usual = min(most, int(crest[255] * focal / d))
        tall = min(most, int(rules.highest * focal / d))
        strip = usual
        share = np.float32(0.0)
        below = _answer(d, errors)
        if view.there:
            low = upsample_pixel(view, min(v + sample, height - 1), u)
            high = upsample_pixel(view, max(v - tall - sample, 0), u)
            share = _step(low, high, d, ground[v - 1, u])
        for s in range(1, min(tall, v) + 1):
            taller = labelled and crest[ids[v - s, u]] > crest[255]
            if not taller and share > 0:
                inverse = upsample_pixel(view, v - s, u)
                side = _farther(inverse, below, ground[v - s, u], errors, rules.network_most)
                taller = share * side < -sure
            if not taller:
                break
            strip = max(strip, s)
        strip = min(strip, v - sample)
        if strip < 1 or v + sample > height:
            continue
        # The far side's colour must be that of the surface that the edge hides, not of what is behind that again.
        behind = ground[v - 1, u]
        thick = 1
        while thick < strip + sample and behind < 1e9 and _same(behind, ground[v - 1 - thick, u], jump):
            behind = ground[v - 1 - thick, u]
            thick += 1
        top = v - strip - sample
        if behind < 1e9 and thick < strip + sample:
            strip = max(thick - sample, thick // 2)
            top = v - thick
            if strip < 1:
                continue
        _sample(color, v, v + sample, u, rules, near, near_var)
        _sample(color, top, v - strip, u, rules, far, far_var)
        constant = np.float32(0.0)
        for j in range(3):
            constant += np.float32(0.5) * np.log(near_var[j] / far_var[j])
        cost, best, cut = np.float32(0.0), -rules.need, 0
        rate = d / (focal * rules.usual_crest)
        for s in range(1, strip + 1):
            r = v - s
            evidence = constant
            for j in range(3):
                a, b = color[r, u, j] - near[j], color[r, u, j] - far[j]
                evidence += np.float32(0.5) * (a * a / near_var[j] - b * b / far_var[j])
            evidence = min(max(rules.temper * evidence, -rules.most), rules.most)
            further = np.float32(0.0)
            if share > 0:
                inverse = upsample_pixel(view, r, u)
                further = share * _farther(inverse, below, ground[r, u], errors, rules.network_most)
            if labelled:
                label = ids[r, u]
                if s * d > crest[label] * focal and further > -sure:
                    evidence = rules.most
                if label == sky:
                    evidence += np.float32(1.0)
            evidence += further
            cost += evidence + rate
            if cost < best:
                best, cut = cost, s
        raised[i] = cut


@helper()
def _same(a: np.float32, b: np.float32, jump: np.float32) -> bool:
    """Return whether neighbouring depths are of one surface."""
    return bool(b < 1e9 and b < jump * a and a < jump * b)


@kernel(nogil=True)
def _raise(
    rows: Int32Array,
    cols: Int32Array,
    raised: Int32Array,
    ground: Float32Array,
    labels: LabelView,
    outline: Float32Array,
    view: NetworkView,
    rules: BoundaryRules,
    surface: Float32Array,
    sigma: Float32Array,
) -> None:
    """Write the near side's depth above each edge, but for pixels that are likelier the far side's by their class,
    their height and which of the two the network sees them nearer to."""
    one = np.float32(1.0)
    for i in range(len(rows)):
        v: Any = np.int64(rows[i])  # else what takes them is compiled for each width
        u: Any = np.int64(cols[i])
        d = ground[v, u]
        for s in range(1, raised[i] + 1):
            if surface[v - s, u] <= d:
                continue
            near = max(sigma[v, u], np.float32(0.02) * d)
            if view.there and ground[v - s, u] > d:
                behind = one / ground[v - s, u]
                toward = (upsample_pixel(view, v - s, u) - behind) / (one / d - behind)
                odds = outline[labels.ids[v - s, u] if labels.known else 255] - np.log(np.float32(s) * d / rules.focal)
                # Not the other way round: where the network has no depth there is no doubt.
                odds += rules.toward * min(max(toward, np.float32(-0.5)), np.float32(1.5))
                likely = one / (one + np.exp(-odds))
                if likely < rules.open:
                    continue
                if likely < rules.sure:
                    if surface[v - s, u] < np.float32(1e9):
                        surface[v - s, u], sigma[v - s, u] = mixture_moments(
                            surface[v - s, u], sigma[v - s, u], d, near, likely
                        )
                        continue
                    if odds < 0:
                        continue
            surface[v - s, u] = d
            sigma[v - s, u] = near
