"""A cell's estimate, frame by frame: compiled.

Each cell has an *estimate* of its height above the reference, which consistent observations refine, and at most one
*candidate*: what contradicts the estimate, until it is contradicted itself or enough independent views confirm it;
then it becomes the estimate. So a lone view, or whatever moves, changes nothing.

Observations of one camera shortly after each other repeat its errors. A camera's weight in a cell therefore grows with
time: a look an hour, however many frames there are. The variance of a mean falls with the number of looks, and the
part of it that poses are to blame for only with the number of cameras. Looks of years ago tell little of today.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ltm_core.terrain.observe_kernel import AGREES, NOTHING, Indices, Seen

Pool = NDArray[np.float32]
Seconds = NDArray[np.uint32]
Masks = NDArray[np.uint32]
Counts = NDArray[np.uint16]
Bytes = NDArray[np.uint8]

NO_LABEL = 255
TALL = 10.0
"""Metres: what rises that high at once is a building or, more often, something that passes before the camera."""
TALL_LOOKS = 2.5
"""Looks of one camera that it takes to believe it; two cameras need no more of them than for anything else."""


class Cells(NamedTuple):
    """State of the tiles in memory, (slots, cells of a tile) each.

    Of the estimate: `dz` metres above the reference; `looks`, the sum of its observations' shares of a look, and
    `weight`, that of share / variance; `sheet_variance`, the mean of what they know of a shift of the whole stand,
    and `pose_variance`, that of the poses' part; `first`, `last` seen (s), `cameras` (a bit each),
    `frames`, `label` last seen. `base`: the canopy that the first consistent observations found (0 where the
    surface raster is known, NaN before). Of the candidate: the same, with c_. Of an accepted change: its kind, the
    smoothed `shift` from the reference and base, since when, and the cameras that agreed then.
    """

    dz: Pool
    looks: Pool
    weight: Pool
    sheet_variance: Pool
    pose_variance: Pool
    first: Seconds
    last: Seconds
    cameras: Masks
    frames: Counts
    label: Bytes
    base: Pool
    c_dz: Pool
    c_looks: Pool
    c_weight: Pool
    c_pose_variance: Pool
    c_first: Seconds
    c_last: Seconds
    c_cameras: Masks
    c_frames: Counts
    kind: Bytes
    shift: Pool
    since: Seconds
    by: Masks


class Scratch(NamedTuple):
    """Sums of one frame, (slots, cells of a tile): of pixels that agree with the reference, of those that do not."""

    number: Pool
    weight: Pool
    moment: Pool
    sheet: Pool
    pose: Pool
    off_count: Pool
    off_weight: Pool
    off_moment: Pool
    off_pose: Pool
    lowest: Pool
    label: Bytes


class Rules(NamedTuple):
    gate: float
    reference_variance: float
    independent_after: float
    settle: float
    memory: float
    lasting: float
    threshold: float
    carve_variance: float


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def mark_tiles(seen: Seen, carved: int, width: int, tile: int, marked: Bytes) -> None:
    """Set the tiles, (rows, cols) of `marked`, that a frame touches."""
    for i in range(len(seen.kind)):
        if seen.kind[i] != NOTHING:
            cell = seen.cell[i]
            marked[cell // width // tile, cell % width // tile] = 1
    for i in range(carved):
        cell = seen.carved_cell[i]
        marked[cell // width // tile, cell % width // tile] = 1


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def scatter(seen: Seen, carved: int, labels: Bytes, width: int, tile: int, slots: Indices, scratch: Scratch) -> None:
    """Add a frame's observations up by cell; `slots`: of each tile, -1 where it is not in memory."""
    for i in range(len(seen.kind)):
        if seen.kind[i] == NOTHING:
            continue
        row, col = seen.cell[i] // width, seen.cell[i] % width
        slot = slots[row // tile, col // tile]
        if slot < 0:
            continue
        k = (row % tile) * tile + col % tile
        w = np.float32(1.0) / (seen.variance[i] + seen.pose_variance[i])
        if seen.kind[i] == AGREES:
            scratch.number[slot, k] += 1
            scratch.weight[slot, k] += w
            scratch.moment[slot, k] += w * seen.dz[i]
            scratch.sheet[slot, k] += seen.sheet_variance[i]
            scratch.pose[slot, k] += seen.pose_variance[i]
        else:
            scratch.off_count[slot, k] += 1
            scratch.off_weight[slot, k] += w
            scratch.off_moment[slot, k] += w * seen.dz[i]
            scratch.off_pose[slot, k] += seen.pose_variance[i]
        if len(labels) > 0:
            scratch.label[slot, k] = labels[i]
    for i in range(carved):
        row, col = seen.carved_cell[i] // width, seen.carved_cell[i] % width
        slot = slots[row // tile, col // tile]
        if slot >= 0:
            k = (row % tile) * tile + col % tile
            scratch.lowest[slot, k] = min(scratch.lowest[slot, k], seen.carved_dz[i])


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _bits(mask: int) -> int:
    count = 0
    while mask:
        mask &= mask - 1
        count += 1
    return count


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def independent(cameras: int, first: int, last: int, independent_after: float, settle: float) -> bool:
    """Whether these views are more than one: two cameras over some time, or one camera long enough apart."""
    span = float(last) - float(first)
    return span >= independent_after or (span >= settle and _bits(cameras) >= 2)


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def mean_variance(looks: float, weight: float, pose_variance: float, cameras: int) -> float:
    """Of an estimate: the observations' own part falls with looks, that of the poses with cameras."""
    total = looks / weight
    pose = min(pose_variance, total)
    variance: float = (total - pose) / max(looks, 1.0) + pose / max(_bits(cameras), 1)
    return variance


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def _share(seconds: int, last: int, cameras: int, bit: int, independent_after: float) -> float:
    """Of a look: all of it for a camera that has not seen the cell, else what has passed of an hour."""
    if (cameras & bit) == 0:
        return 1.0
    return min(max((float(seconds) - float(last)) / independent_after, 1e-3), 1.0)


@njit(cache=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def _remembered(seconds: int, last: int, lasting: float) -> float:
    """What is left of the weight of looks that ended with `last`."""
    passed = float(seconds) - float(last)
    return math.exp(-passed / lasting) if passed > 0 else 1.0


@njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator]
def merge(cells: Cells, scratch: Scratch, slots: Indices, seconds: int, bit: int, rules: Rules) -> int:
    """Take the sums of a frame into the cells of `slots`, and clear them; how many cells it has seen."""
    observed = 0
    for slot in slots:
        for k in range(cells.dz.shape[1]):
            lowest = scratch.lowest[slot, k]
            n, off = scratch.number[slot, k], scratch.off_count[slot, k]
            if n == 0 and off == 0 and math.isinf(lowest):
                continue
            observed += 1
            bounded = False
            if n + off > 0:
                if off > n:
                    weight, moment, pose = (
                        scratch.off_weight[slot, k],
                        scratch.off_moment[slot, k],
                        scratch.off_pose[slot, k],
                    )
                    n = off
                else:
                    weight, moment, pose = scratch.weight[slot, k], scratch.moment[slot, k], scratch.pose[slot, k]
                dz, variance, pose = moment / weight, n / weight, pose / n
                sheet = min(scratch.sheet[slot, k] / n + pose, variance) if off <= scratch.number[slot, k] else variance
            else:
                dz, variance, pose = lowest, rules.carve_variance, np.float32(0.0)
                sheet, bounded = variance, True
            take(cells, slot, k, dz, variance, sheet, pose, bounded, seconds, bit, rules)
            if scratch.label[slot, k] != NO_LABEL:
                cells.label[slot, k] = scratch.label[slot, k]
            scratch.number[slot, k] = scratch.weight[slot, k] = scratch.moment[slot, k] = scratch.pose[slot, k] = 0
            scratch.sheet[slot, k] = scratch.off_count[slot, k] = scratch.off_weight[slot, k] = 0
            scratch.off_moment[slot, k] = scratch.off_pose[slot, k] = 0
            scratch.lowest[slot, k] = np.inf
            scratch.label[slot, k] = NO_LABEL
    return observed


@njit(cache=True, error_model="numpy", inline="always")  # type: ignore[untyped-decorator]
def take(
    cells: Cells,
    slot: int,
    k: int,
    dz: float,
    variance: float,
    sheet: float,
    pose: float,
    bounded: bool,
    seconds: int,
    bit: int,
    rules: Rules,
) -> None:
    """One observation of one cell. `bounded`: the surface is at most `dz`; else it is `dz`."""
    known = cells.looks[slot, k] > 0
    if known:
        here = cells.dz[slot, k]
        doubt = mean_variance(
            cells.looks[slot, k], cells.weight[slot, k], cells.pose_variance[slot, k], cells.cameras[slot, k]
        )
    else:
        base = cells.base[slot, k]
        here = np.float32(0.0) if math.isnan(base) else base
        doubt = rules.reference_variance
    miss = dz - here
    agrees = abs(miss) <= rules.gate * math.sqrt(doubt + variance) or (bounded and miss > 0)
    pending = cells.c_looks[slot, k] > 0
    c_miss, c_slack = 0.0, 0.0
    if pending:
        c_miss = dz - cells.c_dz[slot, k]
        c_doubt = mean_variance(
            cells.c_looks[slot, k], cells.c_weight[slot, k], cells.c_pose_variance[slot, k], cells.c_cameras[slot, k]
        )
        c_slack = rules.gate * math.sqrt(c_doubt + variance)
    if agrees:
        if bounded:
            return
        if not known:
            cells.first[slot, k] = seconds
            cells.last[slot, k] = seconds
        share = _share(seconds, cells.last[slot, k], cells.cameras[slot, k], bit, rules.independent_after)
        kept = _remembered(seconds, cells.last[slot, k], rules.lasting)
        looks = kept * cells.looks[slot, k] + share
        weight = kept * cells.weight[slot, k] + share / variance
        cells.dz[slot, k] = here + share / variance / weight * miss if known else dz
        cells.sheet_variance[slot, k] += share / looks * (sheet - cells.sheet_variance[slot, k])
        cells.pose_variance[slot, k] += share / looks * (pose - cells.pose_variance[slot, k])
        if looks > rules.memory:
            weight *= rules.memory / looks
            looks = rules.memory
        cells.looks[slot, k] = looks
        cells.weight[slot, k] = weight
        cells.first[slot, k] = min(cells.first[slot, k], seconds)
        cells.last[slot, k] = max(cells.last[slot, k], seconds)
        cells.cameras[slot, k] |= bit
        cells.frames[slot, k] = min(cells.frames[slot, k] + 1, 65535)
        if pending and abs(c_miss) > c_slack:
            cells.c_looks[slot, k] = 0
        return
    joins = pending and (abs(c_miss) <= c_slack or (bounded and c_miss > 0))
    if not joins:
        cells.c_dz[slot, k] = dz
        cells.c_looks[slot, k] = 1
        cells.c_weight[slot, k] = 1 / variance
        cells.c_pose_variance[slot, k] = pose
        cells.c_first[slot, k] = cells.c_last[slot, k] = seconds
        cells.c_cameras[slot, k] = bit
        cells.c_frames[slot, k] = 1
        return
    if not bounded or c_miss < 0:
        share = _share(seconds, cells.c_last[slot, k], cells.c_cameras[slot, k], bit, rules.independent_after)
        looks = cells.c_looks[slot, k] + share
        weight = cells.c_weight[slot, k] + share / variance
        cells.c_dz[slot, k] += share / variance / weight * c_miss
        cells.c_pose_variance[slot, k] += share / looks * (pose - cells.c_pose_variance[slot, k])
        cells.c_looks[slot, k], cells.c_weight[slot, k] = looks, weight
    cells.c_first[slot, k] = min(cells.c_first[slot, k], seconds)
    cells.c_last[slot, k] = max(cells.c_last[slot, k], seconds)
    cells.c_cameras[slot, k] |= bit
    cells.c_frames[slot, k] = min(cells.c_frames[slot, k] + 1, 65535)
    passing = cells.c_dz[slot, k] > TALL and cells.c_looks[slot, k] < TALL_LOOKS and _bits(cells.c_cameras[slot, k]) < 2
    if not passing and independent(
        cells.c_cameras[slot, k],
        cells.c_first[slot, k],
        cells.c_last[slot, k],
        rules.independent_after,
        rules.settle,
    ):
        cells.dz[slot, k] = cells.c_dz[slot, k]
        cells.looks[slot, k] = min(cells.c_looks[slot, k], rules.memory)
        cells.weight[slot, k] = cells.c_weight[slot, k] * cells.looks[slot, k] / cells.c_looks[slot, k]
        # What was off its stand tells of its own cell only.
        cells.sheet_variance[slot, k] = cells.looks[slot, k] / cells.weight[slot, k]
        cells.pose_variance[slot, k] = cells.c_pose_variance[slot, k]
        cells.first[slot, k], cells.last[slot, k] = cells.c_first[slot, k], cells.c_last[slot, k]
        cells.cameras[slot, k], cells.frames[slot, k] = cells.c_cameras[slot, k], cells.c_frames[slot, k]
        cells.c_looks[slot, k] = 0
