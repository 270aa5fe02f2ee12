"""Recursive estimate of each cell's surface height, updated frame by frame in compiled code.

Each cell has an *estimate* of its height above the reference, and at most one *candidate*: what contradicts the
estimate, until it is contradicted itself or independent views confirm it; then it becomes the estimate. A camera's
weight in a cell grows with time (one look per hour), because its observations shortly after each other repeat its
errors; the part of the variance that it always repeats falls only with the number of cameras (docs/how/surface.md)."""

import math
from typing import Any, NamedTuple

import numpy as np

from ltm_core.base.kernels import helper, kernel, prefetch
from ltm_core.base.types import Int32Array
from ltm_core.surface.cell_layout import CELLS, PLACE_BITS, FrameSums, TileCells

TALL = 10.0
"""Rise in metres above which a new object is a building or, more often, something that passes the camera."""
WATCHED = 12.5
"""Log odds by which a camera's labels show that something it has seen standing is gone: five sigmas."""
TOLD_AFTER = 72_000.0
"""Seconds for which one camera's labels must contradict what it has seen: fog and dusk, in which they err more, are
over by the next day."""
_STANDS = 0.3
"""Share of a cell's labels, by their log odds, that may show open ground where something is assumed to stand."""
_AHEAD = 12
"""Number of cells whose memory is prefetched."""
TALL_LOOKS = 2.5
"""Number of observations by one camera that confirm it; two cameras need no more than for any other change."""


class Rules(NamedTuple):
    gate: float
    reference_variance: float
    independent_after: float
    settle: float
    memory: float
    lasting: float
    threshold: float
    carve_variance: float
    looked_for: float
    repeated_error_share: float


@helper()
def _bits(mask: int) -> int:
    count = 0
    while mask:
        mask &= mask - 1
        count += 1
    return count


@helper()
def independent(cameras: int, first: int, last: int, independent_after: float, settle: float) -> bool:
    """Return whether these views are independent: two cameras over some time, or one camera long enough apart."""
    span = float(last) - float(first)
    return span >= independent_after or (span >= settle and _bits(cameras) >= 2)


@helper()
def mean_variance(looks: float, weight: float, pose_variance: float, cameras: int, repeated: float) -> float:
    """Return the variance of an estimate. `repeated`: share of the observations' variance that all observations of a
    camera have in common."""
    total = looks / weight
    pose = min(pose_variance, total)
    own = total - pose
    variance: float = (1 - repeated) * own / max(looks, 1.0) + (repeated * own + pose) / max(_bits(cameras), 1)
    return variance


@helper()
def _share(seconds: int, last: int, cameras: int, bit: int, independent_after: float) -> float:
    """Of a look: all of it for a camera that has not seen the cell, else what has passed of an hour."""
    if (cameras & bit) == 0:
        return 1.0
    return min(max((float(seconds) - float(last)) / independent_after, 1e-3), 1.0)


@kernel()
def merge(cells: TileCells, sums: FrameSums, slots: Int32Array, seconds: int, bit: int, rules: Rules) -> int:
    """Take a frame into the cells whose tiles are in memory; how many these are. `slots`: of each tile, flat, -1 where
    it is not in memory."""
    observed, count = 0, sums.used[0]
    for i in range(count):
        ahead = sums.cells[min(i + _AHEAD, count - 1)].place
        prefetch(cells.records, slots[ahead >> PLACE_BITS] * CELLS + (ahead & (CELLS - 1)))
        one = sums.cells[i]
        slot = slots[one.place >> PLACE_BITS]
        if slot < 0:
            continue
        k = one.place & (CELLS - 1)
        observed += 1
        n, bounded, wait = one.number, False, rules.independent_after
        if n + one.off_count > 0:
            if one.off_count > n:
                n, weight, moment, pose = one.off_count, one.off_weight, one.off_moment, one.off_pose
            else:
                weight, moment, pose = one.weight, one.moment, one.pose
            dz, variance, pose = moment / weight, n / weight, pose / n
            relative_variance = (
                min(one.relative_variance / n + pose, variance) if one.off_count <= one.number else variance
            )
            if one.labelled > 0 and one.off_count <= one.number:
                # Depth and label of the same pixels: two words on one height.
                by_label, doubt, shared = _told(cells, slot, k, one, seconds, bit, rules)
                if doubt < variance:
                    wait = max(wait, TOLD_AFTER)
                dz = (dz * doubt + by_label * variance) / (doubt + variance)
                pose = min(pose, shared)
                variance, relative_variance = (
                    max(_both(variance, doubt), pose),
                    max(_both(relative_variance, doubt), pose),
                )
        elif one.labelled > 0:
            dz, variance, pose = _told(cells, slot, k, one, seconds, bit, rules)
            relative_variance, wait = variance, max(wait, TOLD_AFTER)
        else:
            dz, variance, pose = one.lowest, np.float32(rules.carve_variance), np.float32(0.0)
            # That something has gone is no surer than that the ray has passed; how low the cell is then, is.
            relative_variance, bounded = max(variance, (dz / one.passed) ** 2), True
        update_cell(cells, slot, k, dz, variance, relative_variance, pose, bounded, seconds, bit, wait, rules)
        e = cells.records[slot, k]
        if (e.looks > 0 and e.dz > rules.looked_for) or (e.c_looks > 0 and e.c_dz > rules.looked_for):
            cells.high[slot, k] = 1
    return observed


@helper(inline="always")
def _both(one: float, other: float) -> float:
    """Return the variance of the mean of two that know nothing of each other."""
    return one * other / (one + other)


@helper()
def _told(
    cells: TileCells, slot: int, k: int, one: Any, seconds: int, bit: int, rules: Rules
) -> tuple[float, float, float]:
    """Return the height of a cell in which something stood, by its labels, its variance (at which a normal distribution
    would separate the two heights by the labels' log odds), and the pose's part of it. A camera that has seen for an
    hour that it stands has far better odds."""
    e = cells.records[slot, k]
    share = one.gone / (one.gone + one.stays)
    odds, pose = (one.gone + one.stays) / one.labelled, one.labelled_pose / one.labelled
    if e.watched & bit:
        odds = max(odds, np.float32(WATCHED))
    elif (
        share < _STANDS
        and e.looks > 0
        and e.cameras & bit
        and e.dz > -_STANDS * one.stood
        and float(seconds) - float(e.first) >= rules.independent_after
    ):
        e.watched |= bit
    variance = one.stood * one.stood * (np.float32(0.5) / odds + share * (1 - share)) + pose
    return -share * one.stood, variance, pose


@helper()
def update_cell(
    cells: TileCells,
    slot: int,
    k: int,
    dz: float,
    variance: float,
    relative_variance: float,
    pose: float,
    bounded: bool,
    seconds: int,
    bit: int,
    wait: float,
    rules: Rules,
) -> None:
    """Update one cell by one observation. `bounded`: the surface is at most `dz`; else it is `dz`. `relative_variance`:
    variance of the change of the stand about the cell. `wait`: seconds after which one camera's contradicting
    observations are independent."""
    # Does the observation agree with the estimate, and with the candidate that contradicts it?
    e = cells.records[slot, k]
    known = e.looks > 0
    if known:
        here = e.dz
        doubt = mean_variance(e.looks, e.weight, e.pose_variance, e.cameras, rules.repeated_error_share)
    else:
        base = e.base
        here = np.float32(0.0) if math.isnan(base) else base
        doubt = rules.reference_variance
    miss = dz - here
    agrees = abs(miss) <= rules.gate * math.sqrt(doubt + max(variance, relative_variance)) or (bounded and miss > 0)
    pending = e.c_looks > 0
    c_miss, c_slack = 0.0, 0.0
    if pending:
        c_miss = dz - e.c_dz
        c_doubt = mean_variance(e.c_looks, e.c_weight, e.c_pose_variance, e.c_cameras, rules.repeated_error_share)
        c_slack = rules.gate * math.sqrt(c_doubt + variance)
    # It agrees: a further look of the estimate.
    if agrees:
        if bounded:
            return
        if not known:
            e.first = seconds
            e.last = seconds
        share = _share(seconds, e.last, e.cameras, bit, rules.independent_after)
        # What is left of the weight of looks that ended with the last.
        kept = math.exp(-max(float(seconds) - float(e.last), 0.0) / rules.lasting)
        looks = kept * e.looks + share
        weight = kept * e.weight + share / variance
        e.dz = here + share / variance / weight * miss if known else dz
        e.relative_variance += share / looks * (relative_variance - e.relative_variance)
        e.pose_variance += share / looks * (pose - e.pose_variance)
        if looks > rules.memory:
            weight *= rules.memory / looks
            looks = rules.memory
        e.looks = looks
        e.weight = weight
        e.first = min(e.first, seconds)
        e.last = max(e.last, seconds)
        e.cameras |= bit
        e.frames = min(e.frames + 1, 65535)
        if pending and abs(c_miss) > c_slack:
            e.c_looks = 0
        return
    # It contradicts: a new candidate, or a further look of the one that waits.
    joins = pending and (abs(c_miss) <= c_slack or (bounded and c_miss > 0))
    if not joins:
        e.c_dz = dz
        e.c_looks = 1
        e.c_weight = 1 / variance
        # A deviation from the stand is evidence for the own cell only.
        e.c_relative_variance = max(variance, relative_variance)
        e.c_pose_variance = pose
        e.c_first = e.c_last = seconds
        e.c_cameras = bit
        e.c_frames = 1
        return
    if not bounded or c_miss < 0:
        share = _share(seconds, e.c_last, e.c_cameras, bit, rules.independent_after)
        looks = e.c_looks + share
        weight = e.c_weight + share / variance
        e.c_dz += share / variance / weight * c_miss
        e.c_relative_variance += share / looks * (max(variance, relative_variance) - e.c_relative_variance)
        e.c_pose_variance += share / looks * (pose - e.c_pose_variance)
        e.c_looks, e.c_weight = looks, weight
    e.c_first = min(e.c_first, seconds)
    e.c_last = max(e.c_last, seconds)
    e.c_cameras |= bit
    e.c_frames = min(e.c_frames + 1, 65535)
    # The candidate becomes the estimate when independent looks agree on it.
    passing = e.c_dz > TALL and e.c_looks < TALL_LOOKS and _bits(e.c_cameras) < 2
    if not passing and independent(e.c_cameras, e.c_first, e.c_last, wait, rules.settle):
        e.dz = e.c_dz
        e.looks = min(e.c_looks, rules.memory)
        e.weight = e.c_weight * e.looks / e.c_looks
        e.relative_variance = e.c_relative_variance
        e.pose_variance = e.c_pose_variance
        e.first, e.last = e.c_first, e.c_last
        e.cameras, e.frames = e.c_cameras, e.c_frames
        e.c_looks = 0
