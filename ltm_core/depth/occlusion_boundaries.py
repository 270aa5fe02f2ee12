"""Where one ridge stands before another, the photo knows better than the DEM where the edge runs.

What grows on a crest, and a raster that rounds crests off, move the true edge up in the image by some pixels. In this
strip the terrain's answer is wrong by the whole distance between the two ridges. For every column the pixels above a
traced silhouette are given to the near or to the far side by colour: each side's mean and variance are taken next to
the strip, and one cut between them is chosen where the likelihood is greatest, under a prior that falls off with
the height that the cover would have. A network whose depth has been fitted says as well which side a pixel is nearer
to; what it takes for near may stand higher than cover does.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba
import numpy as np

from ltm_core.camera import Camera
from ltm_core.depth.class_priors import ClassPriors
from ltm_core.depth.depth_discontinuities import DepthDiscontinuities
from ltm_core.depth.edge_smoothing import smoothed_edge_heights
from ltm_core.depth.error_model import expected_prediction
from ltm_core.depth.expected_surface import JUMP
from ltm_core.depth.guided_upsampling import NetworkView, upsample_pixel
from ltm_core.depth.occlusion_prior import OPEN, mixture_moments
from ltm_core.types import Float32Array, Int32Array, UInt8Array

_Answer = tuple[np.float32, np.float32, np.float32, np.float32]
"""True inverse depth, by how much less the network says there, the sigma of that, all 1/m, and its logarithm."""

USUAL_CREST = 0.25
"""Metres by which crests are usually raised: the prior of a cut falls by e for each."""
STRIP_PX = 60
"""Most pixels that a silhouette is raised: a near crest's cover is not a strip but an object."""
STRIP_CELLS = 6.0
"""The same in rows of a network's depth, where there is one: it sees by itself what stands higher."""
_SAMPLE, _HALF = 8, 4  # rows of a side's colour sample, and columns to each side of the middle one
_COLOR_NOISE = 16.0  # least variance of a colour, squared 8-bit steps
_TEMPER = 0.6  # of a pixel's colour likelihood: neighbours share texture, so they are not independent
_MOST = 8.0  # log likelihood that one pixel's colour may carry
_NETWORK_MOST = 3.0  # the same of its network depth
_NETWORK_SURE = 1.0  # log likelihood from which on the network may raise an edge beyond the usual cover
_TOWARD = 1.9  # log odds that a pixel is of a crest which the network sees as near as the crest; see `OUTLINE`
_NEED = 1.0  # log odds by which a cut must be better than none
_BLUR = (5, 3)


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """Traced edges between a near surface and what is behind it, from the lowest in the image up, column by column.

    `rows`, `cols`: (N,) int32, the topmost pixel of the near surface. `depth`: (N,) float32 metres of it. `raised`:
    (N,) int32 pixels by which the photo puts the edge higher.
    """

    rows: Int32Array
    cols: Int32Array
    depth: Float32Array
    raised: Int32Array


def refine_occlusion_boundaries(
    rgb: UInt8Array,
    ground: Float32Array,
    surface: Float32Array,
    sigma: Float32Array,
    labels: UInt8Array | None,
    classes: ClassPriors,
    camera: Camera,
    network: NetworkView | None = None,
    edges: DepthDiscontinuities | None = None,
) -> Silhouettes:
    """Move the edges of `surface` and `sigma` (H, W), in place, to where the photo has them; the edges found.

    `labels`: (H, W) ids of `classes`, or None. `network`: what it sees at the photo's size, where there is one.
    `edges`: of `ground`, where they are known.
    """
    edges = DepthDiscontinuities.of(ground) if edges is None else edges
    rows, cols = edges.rows, edges.cols
    crest = classes.crest
    highest = np.float32(crest[255] if labels is None and network is None else crest.max())
    color = np.asarray(cv2.blur(rgb, _BLUR), np.uint8) if len(rows) else rgb
    raised = np.zeros(len(rows), np.int32)
    seen = NetworkView.none() if network is None else network
    ids = np.zeros((1, 1), np.uint8) if labels is None else labels
    _cut(
        color,
        ground,
        ids,
        labels is not None,
        crest,
        highest,
        classes.sky,
        np.float32(camera.fy),
        seen.cells,
        seen.grey,
        seen.columns,
        seen.parts,
        seen.error_model.shift,
        seen.error_model.factor,
        network is not None,
        np.float32(JUMP),
        rows,
        cols,
        raised,
    )
    raised = smoothed_edge_heights(rows, cols, raised, ground.shape[1])
    _raise(
        rows,
        cols,
        raised,
        ground,
        ids,
        labels is not None,
        classes.outline,
        np.float32(camera.fy),
        seen.cells,
        seen.grey,
        seen.columns,
        seen.parts,
        network is not None,
        surface,
        sigma,
    )
    return Silhouettes(rows, cols, ground[rows, cols], raised)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _sample(color: UInt8Array, top: int, bottom: int, u: int, mean: Float32Array, var: Float32Array) -> None:
    """Mean and variance (3,) of the colours in rows [top, bottom) about column u."""
    left, right = max(u - _HALF, 0), min(u + _HALF + 1, color.shape[1])
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
        var[j] = max(var[j] / count - mean[j] * mean[j], np.float32(0.0)) + np.float32(_COLOR_NOISE)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _step(low: np.float32, high: np.float32, near: np.float32, far: np.float32) -> np.float32:
    """How far the network sees the terrain's step at an edge, 0 to 1: between what it gives surely below (`low`) and
    surely above (`high`), 1/m. One whose edges are soft, or elsewhere, has little to say here.
    """
    share = (low - high) / (1 / near - (1 / far if far < 1e9 else np.float32(0.0)))
    return min(share, 1 / share) if share > 0 else np.float32(0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _answer(depth: np.float32, row: int, col: int, shift: Float32Array, factor: Float32Array) -> _Answer:
    """What the network says of a surface of known `depth`, which may be inf. `row`, `col`: of the tables."""
    true = np.float32(1.0) / depth
    less, spread = expected_prediction(row, col, true, shift, factor)
    return true, less, spread, np.log(spread)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _against(inverse: np.float32, answer: _Answer) -> np.float32:
    """Log likelihood by which what the network sees, 1/m, speaks against a surface."""
    true, less, spread, log = answer
    off = (inverse - true + less) / spread
    return np.float32(0.5) * off * off + log


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _farther(
    inverse: np.float32, near: _Answer, far: np.float32, row: int, col: int, shift: Float32Array, factor: Float32Array
) -> np.float32:
    """Log likelihood that the network speaks for the far side, of depth `far`, and not for the near one."""
    if np.isnan(inverse) or np.isnan(far):
        return np.float32(0.0)
    gain = _against(inverse, near) - _against(inverse, _answer(far, row, col, shift, factor))
    return min(max(gain, np.float32(-_NETWORK_MOST)), np.float32(_NETWORK_MOST))


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _cut(
    color: UInt8Array,
    ground: Float32Array,
    labels: UInt8Array,
    labelled: bool,
    crest: Float32Array,
    highest: np.float32,
    sky: int,
    focal: np.float32,
    cells: Float32Array,
    grey: UInt8Array,
    columns: Int32Array,
    parts: Float32Array,
    shift: Float32Array,
    factor: Float32Array,
    networked: bool,
    jump: np.float32,
    rows: Int32Array,
    cols: Int32Array,
    raised: Int32Array,
) -> None:
    height = color.shape[0]
    near, near_var = np.empty(3, np.float32), np.empty(3, np.float32)
    far, far_var = np.empty(3, np.float32), np.empty(3, np.float32)
    most = STRIP_PX
    if networked:
        most = min(most, int(np.ceil(STRIP_CELLS * np.float32(height) / cells.shape[1])))
    for i in range(len(rows)):
        v, u = rows[i], cols[i]
        d = ground[v, u]
        row, col = v * shift.shape[0] // height, u * shift.shape[1] // color.shape[1]
        # The widest strip that any class allows decides where the far side's colour is taken; for most columns
        # no pixel is of a tall class and the usual crest's strip will do.
        usual = min(most, int(crest[255] * focal / d))
        tall = min(most, int(highest * focal / d))
        strip = usual
        share = np.float32(0.0)
        below = _answer(d, row, col, shift, factor)
        if networked:
            low = upsample_pixel(cells, grey, columns, parts, min(v + _SAMPLE, height - 1), u)
            high = upsample_pixel(cells, grey, columns, parts, max(v - tall - _SAMPLE, 0), u)
            share = _step(low, high, d, ground[v - 1, u])
        for s in range(1, min(tall, v) + 1):
            taller = labelled and crest[labels[v - s, u]] > crest[255]
            if not taller and share > 0:
                inverse = upsample_pixel(cells, grey, columns, parts, v - s, u)
                side = _farther(inverse, below, ground[v - s, u], row, col, shift, factor)
                taller = share * side < -_NETWORK_SURE
            if not taller:
                break
            strip = max(strip, s)
        strip = min(strip, v - _SAMPLE)
        if strip < 1 or v + _SAMPLE > height:
            continue
        # The far side's colour must be that of the surface that the edge hides, not of what is behind that again.
        behind = ground[v - 1, u]
        thick = 1
        while thick < strip + _SAMPLE and behind < 1e9 and _same(behind, ground[v - 1 - thick, u], jump):
            behind = ground[v - 1 - thick, u]
            thick += 1
        top = v - strip - _SAMPLE
        if behind < 1e9 and thick < strip + _SAMPLE:
            strip = max(thick - _SAMPLE, thick // 2)
            top = v - thick
            if strip < 1:
                continue
        _sample(color, v, v + _SAMPLE, u, near, near_var)
        _sample(color, top, v - strip, u, far, far_var)
        constant = np.float32(0.0)
        for j in range(3):
            constant += np.float32(0.5) * np.log(near_var[j] / far_var[j])
        cost, best, cut = np.float32(0.0), np.float32(-_NEED), 0
        rate = d / (focal * np.float32(USUAL_CREST))
        for s in range(1, strip + 1):
            r = v - s
            evidence = constant
            for j in range(3):
                a, b = color[r, u, j] - near[j], color[r, u, j] - far[j]
                evidence += np.float32(0.5) * (a * a / near_var[j] - b * b / far_var[j])
            evidence = min(max(np.float32(_TEMPER) * evidence, np.float32(-_MOST)), np.float32(_MOST))
            further = np.float32(0.0)
            if share > 0:
                inverse = upsample_pixel(cells, grey, columns, parts, r, u)
                further = share * _farther(inverse, below, ground[r, u], row, col, shift, factor)
            if labelled:
                label = labels[r, u]
                if s * d > crest[label] * focal and further > -_NETWORK_SURE:
                    evidence = np.float32(_MOST)
                if label == sky:
                    evidence += np.float32(1.0)
            evidence += further
            cost += evidence + rate
            if cost < best:
                best, cut = cost, s
        raised[i] = cut


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _same(a: np.float32, b: np.float32, jump: np.float32) -> bool:
    """Whether neighbouring depths are of one surface."""
    return bool(b < 1e9 and b < jump * a and a < jump * b)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _raise(
    rows: Int32Array,
    cols: Int32Array,
    raised: Int32Array,
    ground: Float32Array,
    labels: UInt8Array,
    labelled: bool,
    outline: Float32Array,
    focal: np.float32,
    cells: Float32Array,
    grey: UInt8Array,
    columns: Int32Array,
    parts: Float32Array,
    networked: bool,
    surface: Float32Array,
    sigma: Float32Array,
) -> None:
    """Write the near side's depth above each edge, but for pixels that are likelier the far side's by their class,
    their height and which of the two the network sees them nearer to."""
    one = np.float32(1.0)
    for i in range(len(rows)):
        v, u = rows[i], cols[i]
        d = ground[v, u]
        for s in range(1, raised[i] + 1):
            if surface[v - s, u] <= d:
                continue
            near = max(sigma[v, u], np.float32(0.02) * d)
            if networked and ground[v - s, u] > d:
                behind = one / ground[v - s, u]
                toward = (upsample_pixel(cells, grey, columns, parts, v - s, u) - behind) / (one / d - behind)
                odds = outline[labels[v - s, u] if labelled else 255] - np.log(np.float32(s) * d / focal)
                # Not the other way round: where the network has no depth there is no doubt.
                odds += np.float32(_TOWARD) * min(max(toward, np.float32(-0.5)), np.float32(1.5))
                likely = one / (one + np.exp(-odds))
                if likely < np.float32(OPEN):
                    continue
                if likely < np.float32(1.0 - OPEN):
                    if surface[v - s, u] < np.float32(1e9):
                        surface[v - s, u], sigma[v - s, u] = mixture_moments(
                            surface[v - s, u], sigma[v - s, u], d, near, likely
                        )
                        continue
                    if odds < 0:
                        continue
            surface[v - s, u] = d
            sigma[v - s, u] = near
