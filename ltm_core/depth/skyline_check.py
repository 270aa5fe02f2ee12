"""Whether the traced skyline lies where the labels' sky ends.

The traced skyline is shifted over the observed one, column by column. Ground that is seen as sky speaks against a
place, and so does sky that is seen as land, beyond what cover on the crest explains: both in sigmas of the label's
edge, the direction and the height of the DEM. Where unknown land may stand behind known ground, only the former counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from ltm_core.camera import Camera

Floats = NDArray[np.float32]

COLUMNS = 480
"""Of a photo, about, that are looked at."""
LEAST_SHARE = 0.3
"""Of the columns that must have a known skyline beyond near crests: a short piece fits at many places."""
_EDGE = 0.75  # sigma of the labels' edge, in steps between columns
_USUALLY = 2 / 3  # of the height that a class may rise to
_RUN = 3  # rows of land that end the sky
_MOST = 4.0  # sigmas beyond which a column counts no more: labels err, clouds hide
_SHARE = 0.6  # of the columns that must still be seen after a shift
_HOPELESS = 3.0  # mean square of sigmas at the best place: then nothing fits
_AS_WELL, _AND = 1.25, 0.25  # factor and addend of the best cost that fit about as well


@dataclass(frozen=True)
class SkylineCheck:
    """`columns` with a known far skyline. `pitch_deg`, `azimuth_deg`: turn of the camera (up, clockwise) that fits
    best. `least_deg`: the smallest turn that fits about as well. `gain`: cost without a turn over that at the best.
    """

    columns: int
    pitch_deg: float
    azimuth_deg: float
    least_deg: float
    gain: float


def check_skyline(
    labels: NDArray[np.uint8],
    sky: int,
    ground: Floats,
    camera: Camera,
    angle_sigma: float,
    dem_sigma: float,
    crest: Floats,
    nearest: float,
    reach: float,
) -> SkylineCheck | None:
    """Compare the traced depth's (H, W) skyline with that of the labels (H, W); None where too little is known.

    `crest`: (256,) metres to which each class may rise over a crest. `nearest`: metres; crests that are nearer say
    nothing. `reach`: radians of the largest turn that is tried.
    """
    width = ground.shape[1]
    step = max(1, round(width / COLUMNS))
    cols = np.arange(step // 2, width, step)
    observed = _sky_ends(labels[:, cols] == sky)
    traced = ground[:, cols]
    known = np.isfinite(traced)
    top = np.where(known.any(axis=0), known.argmax(axis=0), 0)
    index = np.arange(len(cols))
    edge = top > 0
    depth = np.where(edge, traced[top, index], 1.0).astype(np.float64)
    pixels = camera.fy / depth  # that a metre spans
    far = edge & (depth > nearest)
    # What stands on the crest is of the class that the sky ends at.
    border = np.minimum(observed.astype(np.intp) + 1, len(labels) - 1)
    cover = np.empty(len(cols))
    cover[:] = _USUALLY * crest[labels[border, cols]]
    open_above = far & np.isposinf(traced[np.maximum(top - 1, 0), index])
    if open_above.mean() < LEAST_SHARE or not (observed > 0).any():
        return None
    sigma = np.sqrt((_EDGE * step) ** 2 + (angle_sigma * camera.fy) ** 2 + (dem_sigma * pixels) ** 2)
    cells = int(reach * camera.fy / step)
    costs = _costs(observed, top.astype(np.float64), far, open_above, cover * pixels, sigma, cells, step)
    down, right = np.mgrid[-cells : cells + 1, -cells : cells + 1] * step
    best = np.unravel_index(int(np.argmin(costs)), costs.shape)
    lowest = float(costs[best])
    if lowest > _HOPELESS:
        return None
    turns = np.degrees(np.hypot(down, right) / camera.fy)
    least = float(turns[costs <= _AS_WELL * lowest + _AND].min())
    return SkylineCheck(
        int(open_above.sum()),
        math.degrees(float(down[best]) / camera.fy),
        -math.degrees(float(right[best]) / camera.fx),
        least,
        float(costs[cells, cells]) / max(lowest, 0.1),
    )


def _sky_ends(sky: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The first row (C,) of `sky` (H, C) from which on some rows are land; 0 without sky, H without land."""
    land = ~sky
    run = land[: 1 - _RUN].copy()
    for i in range(1, _RUN):
        run &= land[i : i + len(run)]
    return np.where(run.any(axis=0), run.argmax(axis=0), len(sky)).astype(np.float64)


@numba.njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _costs(
    observed: NDArray[np.float64],
    top: NDArray[np.float64],
    far: NDArray[np.bool_],
    open_above: NDArray[np.bool_],
    cover: NDArray[np.float64],
    sigma: NDArray[np.float64],
    cells: int,
    step: int,
) -> NDArray[np.float64]:
    """Mean square of sigmas, capped, for every shift by -cells..cells steps down and right."""
    count = len(observed)
    usable = 0
    for k in range(count):
        usable += open_above[k]
    costs = np.empty((2 * cells + 1, 2 * cells + 1))
    for i in range(2 * cells + 1):
        for j in range(2 * cells + 1):
            total, seen = 0.0, 0
            for k in range(count):
                q = k - (j - cells)
                if q < 0 or q >= count or not far[q]:
                    continue
                place = max(top[q] + (i - cells) * step, 0.0)
                off = place - observed[k]
                if off > 0:
                    if not open_above[q]:
                        continue
                    off = max(0.0, off - cover[q])
                z = off / sigma[q]
                total += min(z * z, _MOST * _MOST)
                seen += open_above[q]
            lost = max(0.0, _SHARE * usable - seen)
            # Columns that leave the photo count as misfits: the rest must not look the better for it.
            costs[i, j] = (total + lost * _MOST * _MOST) / max(seen + lost, 1.0)
    return costs
