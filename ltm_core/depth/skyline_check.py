"""Check that the traced skyline matches the edge of the labels' sky, by shifting one over the other.

Where unknown land may rise behind known ground, only ground that is seen as sky contradicts a place."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from ltm_core.base.kernels import kernel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, UInt8Array
from ltm_core.depth.fusion_config import PoseCheckConfig
from ltm_core.geometry.camera import Camera


@dataclass(frozen=True)
class SkylineCheck:
    """Result of the check. `columns`: number with a known far skyline. `pitch_deg`, `azimuth_deg`: turn of the camera
    (up, clockwise) with the best fit. `least_deg`: smallest turn that fits about as well. `gain`: ratio of the cost
    without a turn to that at the best one."""

    columns: int
    pitch_deg: float
    azimuth_deg: float
    least_deg: float
    gain: float


def check_skyline(
    labels: UInt8Array,
    sky: int,
    ground: Float32Array,
    camera: Camera,
    angle_sigma: float,
    dem_sigma: float,
    crest: Float32Array,
    nearest: float,
    reach: float,
    config: PoseCheckConfig,
    cell: float = 1.0,
) -> SkylineCheck | None:
    """Compare the traced depth's (H, W) skyline with that of the labels (H, W); return None if too little is known.
    `crest`: (256,) metres that each class may rise over a crest. `nearest`: minimum range of crests in metres. `reach`:
    maximum turn in radians. `cell`: pixels of the photo per pixel of the labels' network."""
    width = ground.shape[1]
    step = max(1, round(width / config.columns))
    cols = np.arange(step // 2, width, step)
    height = len(labels)
    seen, known = labels[:, cols] != sky, ground[:, cols] < np.float32(1e9)
    land = np.logical_and.reduce([seen[k : height - config.run + 1 + k] for k in range(config.run)])
    observed = np.where(land.any(0), land.argmax(0), height).astype(np.float64)  # 0 without sky, H without land
    top = known.argmax(0)  # 0 without known ground
    edge = top > 0
    depth = np.where(edge, ground[top, cols], 1.0).astype(np.float64)
    pixels = camera.fy / depth  # that a metre spans
    far = edge & (depth > nearest)
    # What stands on the crest is of the class that the sky ends at.
    border = np.minimum(observed.astype(np.intp) + 1, height - 1)
    cover = crest[labels[border, cols]].astype(np.float64)
    open_above = far & np.isposinf(ground[np.maximum(top - 1, 0), cols])
    if open_above.mean() < config.least_share or not (observed > 0).any():
        return None
    drawn = (config.edge * max(step, cell)) ** 2 + _within(top.astype(np.float64), max(1, round(cell / step))) ** 2
    sigma = np.sqrt(drawn + (angle_sigma * camera.fy) ** 2 + (dem_sigma * pixels) ** 2)
    cells = int(reach * camera.fy / step)
    costs = _costs(
        observed, top.astype(np.float64), far, open_above, cover * pixels, sigma, cells, step, config.most, config.share
    )
    down, right = np.mgrid[-cells : cells + 1, -cells : cells + 1] * step
    best = np.unravel_index(int(np.argmin(costs)), costs.shape)
    lowest = float(costs[best])
    if lowest > config.hopeless:
        return None
    turns = np.degrees(np.hypot(down, right) / camera.fy)
    least = float(turns[costs <= config.skyline_as_well * lowest + config.skyline_margin].min())
    return SkylineCheck(
        int(open_above.sum()),
        math.degrees(float(down[best]) / camera.fy),
        -math.degrees(float(right[best]) / camera.fx),
        least,
        float(costs[cells, cells]) / max(lowest, config.lucky),
    )


def _within(top: Float64Array, columns: int) -> Float64Array:
    """Return the standard deviation of the skyline (C,) over a window of columns about each."""
    size = columns | 1
    mean = uniform_filter1d(top, size, mode="nearest")
    return np.asarray(np.sqrt(np.maximum(uniform_filter1d(top * top, size, mode="nearest") - mean * mean, 0.0)))


@kernel(nogil=True)
def _costs(
    observed: Float64Array,
    top: Float64Array,
    far: BoolArray,
    open_above: BoolArray,
    cover: Float64Array,
    sigma: Float64Array,
    cells: int,
    step: int,
    most: float,
    share: float,
) -> Float64Array:
    """Return the mean square of sigmas, capped, for every shift by -cells..cells steps down and right."""
    count, side = len(observed), 2 * cells + 1
    usable = 0
    for k in range(count):
        usable += open_above[k]
    total, seen = np.zeros((side, side)), np.zeros(side)
    weight = 1.0 / sigma
    allowed = np.empty(side)
    for q in range(count):
        if not far[q]:
            continue
        for i in range(side):
            allowed[i] = max(top[q] + (i - cells) * step, 0.0)
        first, last = max(cells - q, 0), min(cells + count - q, side)
        for j in range(first, last):
            seen[j] += open_above[q]
            end = observed[q + j - cells]
            for i in range(side):
                # Sky that is seen as land: nothing where unknown land may stand behind, and less by cover.
                off = allowed[i] - end
                over = max(0.0, off - cover[q]) if open_above[q] else 0.0
                z = (over if off > 0 else off) * weight[q]
                total[j, i] += min(z * z, most * most)
    costs = np.empty((side, side))
    for j in range(side):
        lost = max(0.0, share * usable - seen[j])
        for i in range(side):
            # Columns that leave the photo count as misfits: the rest must not look the better for it.
            costs[i, j] = (total[j, i] + lost * most * most) / max(seen[j] + lost, 1.0)
    return costs
