"""Form the votes of a frame in one compiled pass over its pixels: each pixel's cell, and sums over each cell's
pixels."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ltm_core.base.kernels import helper, kernel
from ltm_core.base.types import BoolArray, Float32Array, Float64Array, Int64Array, UInt8Array, UInt32Array
from ltm_core.fuel.life_form import PARTS, GroundLimits
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose

_NO_MASKS, _NO_KINDS = np.zeros((2, 1, 1), np.uint16), np.zeros(256, np.uint8)


class VoteSums(NamedTuple):
    """Sums over the pixels of each seen cell, in row-major order of the cells. `cells`: (N,) int64 row * width + col in
    the fuel grid. `counts`: (N, K) uint32 pixels by class. `confidence`: (N,) mean of the pixels' confidence, 0..255.
    `x`, `y`: (N,) mean map coordinates of what they see, metres. `withdrawn`: number of pixels that were not counted,
    because it is too steep for their class."""

    cells: Int64Array
    counts: UInt32Array
    confidence: Float64Array
    x: Float64Array
    y: Float64Array
    withdrawn: int


def sum_pixels(
    distance: Float32Array,
    along_axis: bool,
    camera: Camera,
    pose: Pose,
    labels: UInt8Array,
    confidence: UInt8Array | None,
    counted: BoolArray,
    classes: int,
    geometry: GridGeometry,
    max_range: float,
    limits: GroundLimits | None = None,
) -> VoteSums:
    """Sum over all pixels that see the grid within `max_range` and whose label is `counted` (256,). `distance`: (H, W)
    metres, along the optical axis or (not `along_axis`) along the ray. A pixel's place is rounded to float32, as
    `RangeImage.points` gives it. `limits`: pixels of classes beyond them are withdrawn, and cells of which half of the
    pixels or more are: what is left of these would stand for what it is not."""
    east, north = pose.position[:2]
    first_row, first_col, height, width = _window(geometry, float(east), float(north), max_range)
    capacity = min(height * width, distance.size)
    if capacity == 0:
        none, nothing = np.zeros(0, np.int64), np.zeros(0)
        return VoteSums(none, np.zeros((0, classes), np.uint32), nothing, nothing, nothing, 0)
    # calloc'ed: pages that no pixel touches cost nothing.
    slots = np.zeros(height * width, np.int32)
    cells = np.zeros(capacity, np.int64)
    counts = np.zeros((capacity, classes), np.uint32)
    sums = np.zeros((capacity, 3))
    withdrawn = np.zeros(capacity, np.uint32)
    masks, kinds = (limits.masks, limits.kinds) if limits is not None else (_NO_MASKS, _NO_KINDS)
    place = np.ascontiguousarray(pose.rotation, np.float64), float(east), float(north)
    sure = _read_only(np.zeros((1, 1), np.uint8) if confidence is None else confidence, np.uint8)
    used = _scan(
        *(_read_only(distance, np.float32), along_axis, *_tangents(camera), *place),
        *(_read_only(labels, np.uint8), sure, confidence is not None, counted),
        (geometry.x_min, geometry.y_max, geometry.resolution),
        (first_row, first_col, height, width, geometry.width),
        *(float(max_range), masks, kinds, slots, cells, counts, sums, withdrawn),
    )
    order = np.argsort(cells[:used])
    pixels, total = counts[order].sum(axis=1), int(withdrawn[:used].sum())
    if total:
        kept = pixels > withdrawn[order]
        order, pixels = order[kept], pixels[kept]
    mean = sums[order] / np.maximum(pixels, 1)[:, None]
    return VoteSums(cells[order], counts[order], mean[:, 2], mean[:, 0] + east, mean[:, 1] + north, total)


def _read_only(array: NDArray[Any], dtype: Any) -> NDArray[Any]:
    """Return the contiguous and read-only, so that one compiled kernel serves arrays of messages and of our own."""
    view: NDArray[Any] = np.ascontiguousarray(array, dtype).view()
    view.flags.writeable = False
    return view


def _window(geometry: GridGeometry, east: float, north: float, max_range: float) -> tuple[int, int, int, int]:
    """Return (row, col, height, width) of the grid's part within reach of the camera."""
    if not np.isfinite(max_range):
        return 0, 0, geometry.height, geometry.width
    # Clipped before they become integers: a pose may say that a camera stands at the end of the world.
    row, col = geometry.to_grid([east - max_range, east + max_range], [north + max_range, north - max_range])
    rows = np.clip([row[0] - 1, row[1] + 2], 0, geometry.height).astype(np.int64)
    cols = np.clip([col[0] - 1, col[1] + 2], 0, geometry.width).astype(np.int64)
    return int(rows[0]), int(cols[0]), int(rows[1] - rows[0]), int(cols[1] - cols[0])


@lru_cache(maxsize=16)  # of a site's cameras, each of which needs its own for every frame: 17 MB at 1080p
def _tangents(camera: Camera) -> tuple[Float32Array, Float32Array]:
    """x / z and y / z of the pixels' rays; (1, W) and (H, 1) without distortion, else (H, W) both, NaN without ray."""
    if any(camera.distortion):
        x, y, z = np.moveaxis(camera.rays(), -1, 0)
        return (x / z).astype(np.float32), (y / z).astype(np.float32)
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    return x[None].astype(np.float32), y[:, None].astype(np.float32)


EAST, NORTH, SURE = 0, 1, 2
"""Columns of a cell's sums: x and y from the camera (m), and confidence (8 bits)."""


@kernel(nogil=True)
def _scan(
    distance: Any,
    along_axis: bool,
    x_tangent: Any,
    y_tangent: Any,
    rotation: Any,
    east: float,
    north: float,
    labels: Any,
    confidence: Any,
    has_confidence: bool,
    counted: Any,
    grid: tuple[float, float, float],
    window: tuple[int, int, int, int, int],
    max_range: float,
    masks: Any,
    kinds: Any,
    slots: Any,
    cells: Any,
    counts: Any,
    sums: Any,
    withdrawn: Any,
) -> int:
    """Fill `cells`, `counts`, `sums` (x and y from the camera, confidence) and `withdrawn` (by cell); returns how many
    cells are seen. Each image row goes twice: a loop without branches finds the cells, which the compiler turns into
    vector code; a second one adds up, over pixels side by side that show one class in one cell at once."""
    height, width = distance.shape
    x_min, y_max, resolution = grid
    first_row, first_col, rows, cols, grid_width = window
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    tx, ty = np.empty(width, np.float32), np.empty(width, np.float32)
    place = np.empty(width, np.int32)
    dx, dy = np.empty(width, np.float32), np.empty(width, np.float32)
    used, farthest = 0, min(max_range * max_range, 1e300)  # squared, so that no root is taken; the sky is farther
    for v in range(height):
        # A row of one class that does not vote, as of sky, needs no cells.
        u = 0
        while u < width and labels[v, u] == labels[v, 0]:
            u += 1
        if u == width and not counted[labels[v, 0]]:
            continue
        x_row, y_step = v if x_tangent.shape[0] > 1 else 0, 1 if y_tangent.shape[1] > 1 else 0
        for u in range(width):
            tx[u], ty[u] = x_tangent[x_row, u], y_tangent[v, y_step * u]
        # The cell of each pixel, or -1; without branches, for vector code.
        for u in range(width):
            x, y, d = np.float64(tx[u]), np.float64(ty[u]), np.float64(distance[v, u])
            square = 1.0 + x * x + y * y
            reached = d * d * square if along_axis else d * d
            depth = d if along_axis else d / np.sqrt(square)
            ex = depth * (r00 * x + r01 * y + r02)
            ny = depth * (r10 * x + r11 * y + r12)
            dx[u], dy[u] = ex, ny
            c = (np.float64(np.float32(east + ex)) - x_min) / resolution - first_col
            r = (y_max - np.float64(np.float32(north + ny))) / resolution - first_row
            seen = (reached <= farthest) & (c >= 0) & (c < cols) & (r >= 0) & (r < rows)
            place[u] = np.int32(r) * cols + np.int32(c) if seen else -1
        # Runs of pixels that show one class in one cell.
        u = 0
        while u < width:
            here, label = place[u], labels[v, u]
            if here < 0 or not counted[label]:
                u += 1
                continue
            begin = u
            u += 1
            while u < width and place[u] == here and labels[v, u] == label:
                u += 1
            # A slot for each cell that is seen, in the order of first sight.
            slot = slots[here] - 1
            if slot < 0:
                slot = used
                used += 1
                slots[here] = used
                cells[slot] = (first_row + here // cols) * grid_width + first_col + here % cols
            # Sums over the run, without pixels in places where the class cannot stand.
            kind, pixels = kinds[label], u - begin
            east_sum, north_sum, sure = 0.0, 0.0, 0
            for i in range(begin, u):
                if kind > 0 and _too_steep(
                    masks[kind - 1], np.float32(east + dx[i]), np.float32(north + dy[i]), grid, cells[slot]
                ):
                    withdrawn[slot] += np.uint32(1)
                    pixels -= 1
                    continue
                east_sum += dx[i]
                north_sum += dy[i]
                if has_confidence:
                    sure += confidence[v, i]
            counts[slot, label] += np.uint32(pixels)
            sums[slot, EAST] += east_sum
            sums[slot, NORTH] += north_sum
            sums[slot, SURE] += sure
    return used


@helper()
def _too_steep(mask: Any, x: float, y: float, grid: tuple[float, float, float], cell: int) -> bool:
    """Return whether the ground at (x, y), in this cell, is marked in a mask of `GroundLimits`."""
    row, col = cell // mask.shape[1], cell % mask.shape[1]
    if mask[row, col] == 0:
        return False
    x_min, y_max, resolution = grid
    east = min(max(int(((np.float64(x) - x_min) / resolution - col) * PARTS), 0), PARTS - 1)
    south = min(max(int(((y_max - np.float64(y)) / resolution - row) * PARTS), 0), PARTS - 1)
    marked: bool = (mask[row, col] & np.uint16(1 << (south * PARTS + east))) != 0
    return marked
