"""Estimate a run before it starts: existing frames, gaps and cost."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import mean, stdev

from ltm_ros.archive.frame_files import frame_files
from ltm_ros.archive.manifest import ArchiveFrame, days_of
from ltm_ros.archive.plan import MEASURED, VOTES
from ltm_ros.archive.run import Plan

_TRIED = 3
"""Number of frames per camera for the estimate, after one that loads kernels and network."""


@dataclass(frozen=True)
class Cost:
    """CPU seconds per frame from image to votes, and to the terrain's data if used, the standard error of their mean,
    and bytes of both per frame.
    """

    cpu_s: float
    error_s: float
    made_bytes: float


def cost_of(frames: Sequence[ArchiveFrame], planned: Plan) -> Cost:
    """Estimate the cost of a camera's frames from a few of them, spread over all; nothing is kept."""
    steps = {task.frames[0].camera: task for task in planned.tasks}
    wanted = [VOTES, MEASURED] if planned.options.terrain else [VOTES]
    chosen = [frames[round(k * (len(frames) - 1) / max(_TRIED - 1, 1))] for k in range(_TRIED)]
    seconds, sizes = [], []
    for frame in [chosen[0], *chosen]:
        begin = time.process_time()
        made = frame_files(replace(steps[frame.camera], frames=(frame,)), planned.settings, wanted)
        seconds.append(time.process_time() - begin)
        sizes.append(sum(map(len, made.values())))
    return Cost(mean(seconds[1:]), stdev(seconds[1:]) / math.sqrt(_TRIED), mean(sizes[1:]))


COST_COLUMNS = ("camera", ">frames", ">days", ">days without", ">GB in", ">core-hours", ">made, MB")


def cost_rows(planned: Plan) -> list[tuple[str, ...]]:
    """Return frames, gaps and costs of each camera, as `COST_COLUMNS` names them."""
    rows: list[tuple[str, ...]] = []
    days = days_of(planned.frames)
    for camera in sorted({frame.camera for frame in planned.frames}):
        frames = [frame for frame in planned.frames if frame.camera == camera]
        its = sorted(day for name, day in days if name == camera)
        cost = cost_of(frames, planned)
        hours, error = (seconds * len(frames) / 3600 for seconds in (cost.cpu_s, cost.error_s))
        rows.append(
            (
                camera,
                str(len(frames)),
                str(len(its)),
                str(its[-1] - its[0] + 1 - len(its)),
                f"{sum(frame.size_bytes for frame in frames) / 1e9:.3g}",
                f"{hours:.3g} ± {error:.1g}",
                f"{cost.made_bytes * len(frames) / 1e6:.3g}",
            )
        )
    return rows


def lost_rows(planned: Plan) -> list[tuple[str, ...]]:
    """Return camera or place, cause, number of frames and first reason of what cannot be processed."""
    failures = (*planned.manifest.unread, *planned.manifest.failures)
    rows: list[tuple[str, ...]] = [(one.place, one.cause, str(one.count), one.why) for one in failures]
    return rows + [("", "damage", "", note) for note in planned.manifest.damage]


def cost_note(planned: Plan) -> str:
    """Return what the columns of `cost_rows` mean for this run."""
    to = "votes and measured depth, without the terrain's map" if planned.options.terrain else "votes"
    return (
        f"{len(planned.manifest.frames)} frames found, {planned.manifest.repeated} of them duplicates; core-hours "
        f"to {to}, from {_TRIED} frames of each camera, with the standard error; bytes of {to.partition(',')[0]} "
        "as of single frames"
    )
