"""Move the edges between ridges to where the photo shows them, which is more accurate than the DEM.

The pixels above a traced silhouette are given to the near or the far side by colour: one cut a column where the
likelihood is greatest, under a prior that falls with the height of the cover."""

from typing import Any, NamedTuple

import cv2
import numpy as np

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import BoolArray, Float32Array, Int32Array, UInt8Array
from ltm_core.depth.fusion_config import FusionConfig
from ltm_core.depth.ground_sampling import ClassPriors, LabelView
from ltm_core.geometry.camera import Camera


class BoundaryRules(NamedTuple):
    """Compiled form of `BoundaryConfig`, with further values. `highest`: metres that each class may rise over a crest;
    `focal`: pixels; `jump`: ratio of depths between two surfaces."""

    usual_crest: np.float32
    strip_px: int
    sample_rows: int
    sample_columns: int
    color_noise: np.float32
    temper: np.float32
    most: np.float32
    need: np.float32
    highest: np.float32
    focal: np.float32
    jump: np.float32

    @classmethod
    def of(cls, config: FusionConfig, highest: float, focal: float) -> "BoundaryRules":
        given = [getattr(config.boundaries, name) for name in cls._fields[:8]]
        more = map(np.float32, (highest, focal, config.surface.jump))
        return cls(*(v if isinstance(v, int) else np.float32(v) for v in given), *more)  # type: ignore[arg-type]


def refine_occlusion_boundaries(
    rgb: UInt8Array,
    surface: Float32Array,
    sigma: Float32Array,
    ground: Float32Array,
    labels: UInt8Array | None,
    classes: ClassPriors,
    camera: Camera,
    config: FusionConfig,
    hidden: BoolArray | None = None,
) -> None:
    """Move the edges of `ground` in `surface` and `sigma` (H, W), in place, to those of the photo. `labels`: (H, W) ids
    of `classes`, or None. `hidden`: (H, W), pixels at which no edge is seen; None: none."""
    rows, cols = _edges(ground, config.surface.jump, hidden)
    color = np.asarray(cv2.blur(rgb, config.boundaries.blur), np.uint8) if len(rows) else rgb
    highest = float(classes.crest[255] if labels is None else classes.crest.max())
    seen, rules = LabelView.of(labels, classes), BoundaryRules.of(config, highest, camera.fy)
    _cut(color, ground, seen, classes.crest, rules, rows, cols, surface, sigma)


def _edges(ground: Float32Array, jump: float, hidden: BoolArray | None) -> tuple[Int32Array, Int32Array]:
    """Return rows and columns (N,), bottom to top and left to right, of pixels of ground (H, W) below a pixel that is
    at least `jump` times as far, sky or unknown; neither of the two is hidden."""
    here, above = ground[:0:-1], ground[-2::-1]
    near = (here < np.float32(1e9)) & ~(above < np.float32(jump) * here)
    if hidden is not None:
        near &= ~(hidden[:0:-1] | hidden[-2::-1])
    rows, cols = np.divmod(np.flatnonzero(near), ground.shape[1])  # `nonzero` takes longer in two dimensions
    return (len(ground) - 1 - rows).astype(np.int32), cols.astype(np.int32)


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
def _same(a: np.float32, b: np.float32, jump: np.float32) -> bool:
    """Return whether neighbouring depths are of one surface."""
    return bool(b < 1e9 and b < jump * a and a < jump * b)


@kernel(nogil=True)
def _cut(
    color: UInt8Array,
    ground: Float32Array,
    labels: LabelView,
    crest: Float32Array,
    rules: BoundaryRules,
    rows: Int32Array,
    cols: Int32Array,
    surface: Float32Array,
    sigma: Float32Array,
) -> None:
    """Find by how many pixels the photo has each edge higher, then write the near side's depth above each."""
    raised = np.zeros(len(rows), np.int32)
    near, near_var = np.empty(3, np.float32), np.empty(3, np.float32)
    far, far_var = np.empty(3, np.float32), np.empty(3, np.float32)
    ids, labelled, sky = labels.ids, labels.known, labels.sky
    sample, focal = rules.sample_rows, rules.focal
    for i in range(len(rows)):
        v: Any = np.int64(rows[i])  # else what takes them is compiled for each width
        u: Any = np.int64(cols[i])
        d = ground[v, u]
        # The widest strip that any class allows decides where the far side's colour is taken; for most columns
        # no pixel is of a tall class and the usual crest's strip will do.
        strip = min(rules.strip_px, int(crest[255] * focal / d))
        tall = min(rules.strip_px, int(rules.highest * focal / d))
        for s in range(1, min(tall, v) + 1):
            if not (labelled and crest[ids[v - s, u]] > crest[255]):
                break
            strip = max(strip, s)
        strip = min(strip, v - sample)
        if strip < 1 or v + sample > color.shape[0]:
            continue
        # The far side's colour must be that of the surface that the edge hides, not of what is behind that again.
        behind = ground[v - 1, u]
        thick = 1
        while thick < strip + sample and behind < 1e9 and _same(behind, ground[v - 1 - thick, u], rules.jump):
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
            if labelled:
                label = ids[r, u]
                if s * d > crest[label] * focal:
                    evidence = rules.most
                if label == sky:
                    evidence += np.float32(1.0)
            cost += evidence + rate
            if cost < best:
                best, cut = cost, s
        raised[i] = cut
    for i in range(len(rows)):
        v, u = np.int64(rows[i]), np.int64(cols[i])
        d = ground[v, u]
        for r in range(v - raised[i], v):
            if not surface[r, u] <= d:
                surface[r, u], sigma[r, u] = d, max(sigma[v, u], np.float32(0.02) * d)
