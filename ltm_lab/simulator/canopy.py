"""Canopy height above ground, computed from the same triangles that are rendered."""

from collections.abc import Sequence

import numpy as np
from numba import njit

from ltm_core.base.types import Float32Array, Float64Array
from ltm_core.geometry.grid import GridGeometry
from ltm_lab.simulator.terrain_synthesis import HeightField
from ltm_lab.simulator.vegetation import LATTICE, Placement


@njit(cache=True)  # type: ignore[untyped-decorator]
def _highest(triangles: Float64Array, first: float, step: float, out: Float32Array) -> None:
    """Raise `out` (n, n) to the highest triangle over each lattice point (first + col step, first + row step)."""
    n = out.shape[0]
    for k in range(triangles.shape[0]):
        t = triangles[k]
        area = (t[1, 0] - t[0, 0]) * (t[2, 1] - t[0, 1]) - (t[2, 0] - t[0, 0]) * (t[1, 1] - t[0, 1])
        if abs(area) < 1e-12:
            continue
        c0 = max(0, int(np.ceil((min(t[0, 0], t[1, 0], t[2, 0]) - first) / step)))
        c1 = min(n - 1, int(np.floor((max(t[0, 0], t[1, 0], t[2, 0]) - first) / step)))
        r0 = max(0, int(np.ceil((min(t[0, 1], t[1, 1], t[2, 1]) - first) / step)))
        r1 = min(n - 1, int(np.floor((max(t[0, 1], t[1, 1], t[2, 1]) - first) / step)))
        for r in range(r0, r1 + 1):
            for c in range(c0, c1 + 1):
                x = first + c * step - t[0, 0]
                y = first + r * step - t[0, 1]
                u = (x * (t[2, 1] - t[0, 1]) - y * (t[2, 0] - t[0, 0])) / area
                v = (y * (t[1, 0] - t[0, 0]) - x * (t[1, 1] - t[0, 1])) / area
                if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
                    z = t[0, 2] + u * (t[1, 2] - t[0, 2]) + v * (t[2, 2] - t[0, 2])
                    if z > out[r, c]:
                        out[r, c] = z


@njit(cache=True)  # type: ignore[untyped-decorator]
def _stamp(
    heights: Float32Array,
    first: float,
    step: float,
    at: Float64Array,
    slopes: Float64Array,
    ground: Float32Array,
    ground_frame: Float64Array,
    out: Float32Array,
    out_frame: Float64Array,
) -> None:
    """Raise `out` by one plant at each of `at` (N, 3), sheared by `slopes` (N, 2); frames are (x_min, y_max, cell)."""
    n = heights.shape[0]
    rows, cols = out.shape
    for i in range(at.shape[0]):
        for r in range(n):
            for c in range(n):
                if heights[r, c] <= -1e8:
                    continue
                dx = first + c * step
                dy = first + r * step
                x = at[i, 0] + dx
                y = at[i, 1] + dy
                col = int(np.floor((x - out_frame[0]) / out_frame[2]))
                row = int(np.floor((out_frame[1] - y) / out_frame[2]))
                if row < 0 or col < 0 or row >= rows or col >= cols:
                    continue
                gx = min(max((x - ground_frame[0]) / ground_frame[2] - 0.5, 0.0), ground.shape[1] - 1.0)
                gy = min(max((ground_frame[1] - y) / ground_frame[2] - 0.5, 0.0), ground.shape[0] - 1.0)
                j = min(int(gx), ground.shape[1] - 2)
                k = min(int(gy), ground.shape[0] - 2)
                fx = gx - j
                fy = gy - k
                z = (1 - fy) * ((1 - fx) * ground[k, j] + fx * ground[k, j + 1]) + fy * (
                    (1 - fx) * ground[k + 1, j] + fx * ground[k + 1, j + 1]
                )
                height = at[i, 2] + slopes[i, 0] * dx + slopes[i, 1] * dy + heights[r, c] - z
                if height > out[row, col]:
                    out[row, col] = height


def canopy_height(placements: Sequence[Placement], ground: HeightField, geometry: GridGeometry) -> Float32Array:
    """Height (H, W) of the plants over the ground in each cell of `geometry` (map frame), 0 where none stands.

    A cell holds the highest of the plants over the points of a lattice of LATTICE metres inside it, each above the
    ground below it: what a dense airborne scan would grid.
    """
    out = np.zeros(geometry.shape, np.float32)
    out_frame = np.array([geometry.x_min, geometry.y_max, geometry.resolution])
    g = ground.geometry
    ground_frame = np.array([g.x_min, g.y_max, g.resolution])
    elevation = np.ascontiguousarray(ground.elevation, np.float32)
    for placement in placements:
        m = placement.transforms
        keys = np.round(m[:, :2, :2].reshape(-1, 4), 6)
        for key in np.unique(keys, axis=0):
            chosen = np.flatnonzero(np.all(keys == key, axis=1))
            turn = m[chosen[0], :2, :2]
            scale = float(m[chosen[0], 2, 2])
            triangles = placement.prototype.soup.triangles.copy()
            triangles[..., :2] = triangles[..., :2] @ turn.T
            triangles[..., 2] *= scale
            reach = float(np.abs(triangles[..., :2]).max())
            half = int(np.ceil(reach / LATTICE))
            first = -half * LATTICE + LATTICE / 2
            heights = np.full((2 * half, 2 * half), -1e9, np.float32)
            _highest(np.ascontiguousarray(triangles), first, LATTICE, heights)
            # The shear is stated in the plant's own frame; about the vertical it turns with the plant
            slopes = m[chosen, 2, :2] @ np.linalg.inv(turn)
            _stamp(heights, first, LATTICE, m[chosen, :3, 3].copy(), slopes, elevation, ground_frame, out, out_frame)
    return out
