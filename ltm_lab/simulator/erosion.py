"""Landscape evolution: stream-power incision with uplift and hillslope diffusion.

Incision is the implicit O(n) scheme of Braun & Willett (2013, Geomorphology 180-181) with slope exponent 1; hillslopes
diffuse, and slopes above the angle of repose fail towards their lower neighbours. The result has ridges, spurs and a
connected drainage net.
"""

import numpy as np
from numba import njit

from ltm_core.base.types import Float64Array, Int64Array


@njit(cache=True)  # type: ignore[untyped-decorator]
def _receivers(h: Float64Array, cell: float, wander: float, seed: int) -> tuple[Int64Array, Float64Array]:
    """Steepest downhill neighbour of each cell (itself: a pit or the border), and the distance to it.

    Slopes are weighted by 1 +- `wander` at random: without it channels lock to the eight directions of the raster.
    """
    np.random.seed(seed)  # noqa: NPY002 - numba's own generator, local to the thread
    rows, cols = h.shape
    receiver = np.arange(rows * cols)
    distance = np.ones(rows * cols)
    for r in range(1, rows - 1):
        for c in range(1, cols - 1):
            best = 0.0
            for dr in range(-1, 2):
                for dc in range(-1, 2):
                    if dr == 0 and dc == 0:
                        continue
                    d = cell * np.sqrt(float(dr * dr + dc * dc))
                    slope = (h[r, c] - h[r + dr, c + dc]) / d
                    if wander > 0.0:
                        slope *= 1.0 + wander * (2.0 * np.random.random() - 1.0)  # noqa: NPY002
                    if slope > best:
                        best = slope
                        receiver[r * cols + c] = (r + dr) * cols + c + dc
                        distance[r * cols + c] = d
    return receiver, distance


@njit(cache=True)  # type: ignore[untyped-decorator]
def _downstream_order(receiver: Int64Array) -> Int64Array:
    """Cells sorted so that each one's receiver stands before it (Braun & Willett's stack)."""
    n = receiver.size
    donors_at = np.zeros(n + 1, np.int64)
    for i in range(n):
        if receiver[i] != i:
            donors_at[receiver[i] + 1] += 1
    for i in range(n):
        donors_at[i + 1] += donors_at[i]
    fill = donors_at.copy()
    donors = np.empty(n, np.int64)
    for i in range(n):
        if receiver[i] != i:
            donors[fill[receiver[i]]] = i
            fill[receiver[i]] += 1
    order = np.empty(n, np.int64)
    end = 0
    for i in range(n):
        if receiver[i] == i:
            order[end] = i
            end += 1
    k = 0
    while k < end:
        for j in range(donors_at[order[k]], donors_at[order[k] + 1]):
            order[end] = donors[j]
            end += 1
        k += 1
    return order


@njit(cache=True)  # type: ignore[untyped-decorator]
def _upstream_area(receiver: Int64Array, order: Int64Array, cell: float) -> Float64Array:
    """Upstream area (m^2) of each cell, flat; `order`: downstream cells before those that drain into them."""
    area = np.full(receiver.size, cell * cell)
    for k in range(order.size - 1, -1, -1):
        i = order[k]
        if receiver[i] != i:
            area[receiver[i]] += area[i]
    return area


@njit(cache=True)  # type: ignore[untyped-decorator]
def drainage_area(h: Float64Array, cell: float) -> Float64Array:
    """Upstream area (m^2) of each cell of ``h``, by steepest descent."""
    receiver, _ = _receivers(h, cell, 0.0, 0)
    area: Float64Array = _upstream_area(receiver, _downstream_order(receiver), cell)
    return area.reshape(h.shape)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _relax_hillslopes(h: Float64Array, cell: float, diffusion: float, repose: float, sweeps: int) -> None:
    """Explicit diffusion (``diffusion``: D dt / cell^2 a sweep, < 0.25), stronger where the slope is above
    ``repose``."""
    rows, cols = h.shape
    for _ in range(sweeps):
        before = h.copy()
        for r in range(1, rows - 1):
            for c in range(1, cols - 1):
                flux = 0.0
                for k in range(4):
                    rr = r + (1 if k == 0 else -1 if k == 1 else 0)
                    cc = c + (1 if k == 2 else -1 if k == 3 else 0)
                    rise = before[rr, cc] - before[r, c]
                    flux += diffusion * rise
                    over = abs(rise) - repose * cell
                    if over > 0.0:
                        flux += 0.2 * over * (1.0 if rise > 0.0 else -1.0)
                h[r, c] += flux


@njit(cache=True)  # type: ignore[untyped-decorator]
def evolve(
    h: Float64Array,
    cell: float,
    uplift: Float64Array,
    erodibility: Float64Array,
    steps: int,
    time_step: float,
    area_exponent: float,
    diffusivity: float,
    repose: float,
    seed: int,
) -> None:
    """Evolve ``h`` (m) in place by ``steps`` steps of ``time_step`` years; the raster's border is fixed base level.

    ``uplift`` m/a, ``erodibility`` m^(1-2m)/a, ``diffusivity`` m^2/a, ``repose`` the greatest stable slope (tangent).
    """
    rows, cols = h.shape
    number = diffusivity * time_step / (cell * cell)
    sweeps = max(1, int(np.ceil(number / 0.2)))
    for step in range(steps):
        for r in range(1, rows - 1):
            for c in range(1, cols - 1):
                h[r, c] += uplift[r, c] * time_step
        receiver, distance = _receivers(h, cell, 0.6, seed + step)
        order = _downstream_order(receiver)
        area = _upstream_area(receiver, order, cell)
        flat = h.ravel()
        rate = erodibility.ravel()
        for k in range(order.size):
            i = order[k]
            if receiver[i] != i:
                f = rate[i] * time_step * area[i] ** area_exponent / distance[i]
                flat[i] = (flat[i] + f * flat[receiver[i]]) / (1.0 + f)
        _relax_hillslopes(h, cell, number / sweeps, repose, sweeps)
