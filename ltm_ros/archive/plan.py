"""Plan the tasks of an archive, and report what a run would do."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from statistics import mean, stdev

import numpy as np
from rich.table import Table

from ltm_core.base.errors import ArchiveError
from ltm_core.base.utc_time import DAY_NS
from ltm_core.fuel.overlays_io import Burn
from ltm_core.pipeline.frame_steps import LabellingConfig, TracingConfig
from ltm_core.pipeline.fusing_step import FusingConfig
from ltm_core.site.site import Site
from ltm_ros.archive.content_digest import burns_digest, digest, evidence_digest, measured_digest, votes_digest
from ltm_ros.archive.files import CacheConfig
from ltm_ros.archive.frame_files import frame_files
from ltm_ros.archive.manifest import ArchiveFrame, days_of
from ltm_ros.archive.run import Plan

VOTES, EVIDENCE, MEASURED = "votes", "evidence", "measured"
"""Folders of results."""


@dataclass(frozen=True)
class TaskSettings:
    """What all tasks of a run share. `site`: path of the site file, the same for all workers; `results`: URL; `cache`:
    where a worker puts files of archives on stores; `fusing`: how frames are measured, None where they are not."""

    site: str
    results: str
    code: str
    tracing: TracingConfig
    labelling: LabellingConfig
    cache: CacheConfig = field(default_factory=CacheConfig)
    fusing: FusingConfig | None = None


@dataclass(frozen=True)
class Task:
    """Some frames of one camera and day, in the order of their stamps, and the names of the files of its steps.

    `steps_key`: of what makes votes of the camera's frames (`votes_digest`). `burns`: of that day. `fusing_key`,
    `measured_key`: of what measures the frames (`measured_digest`) and of the file; empty where they are not measured.
    """

    frames: tuple[ArchiveFrame, ...]
    steps_key: str
    votes_key: str
    evidence_key: str
    burns: tuple[Burn, ...] = ()
    fusing_key: str = ""
    measured_key: str = ""

    @property
    def files(self) -> tuple[str, ...]:
        """All that are there when it is done."""
        measured = (measured_name(self),) if self.measured_key else ()
        return (evidence_name(self), *measured)

    @property
    def label(self) -> str:
        """For people: camera and day."""
        first = self.frames[0]
        return f"{first.camera} {np.datetime64(first.day, 'D')}"


def votes_name(task: Task) -> str:
    return f"{VOTES}/{task.votes_key}.parquet"


def evidence_name(task: Task) -> str:
    return f"{EVIDENCE}/{task.evidence_key}.parquet"


def measured_name(task: Task) -> str:
    return f"{MEASURED}/{task.measured_key}.parquet"


def plan(
    frames: Sequence[ArchiveFrame],
    site: Site,
    settings: TaskSettings,
    frames_per_task: int,
    burns: Sequence[Burn] = (),
) -> list[Task]:
    """Tasks in the order of days, then cameras. A chunk of a day is decided by its frames' order alone."""
    of_votes = {
        name: votes_digest(site, name, settings.tracing, settings.labelling) for name in {f.camera for f in frames}
    }
    of_measured = {
        name: "" if settings.fusing is None else measured_digest(site, name, votes, settings.fusing)
        for name, votes in of_votes.items()
    }
    of_evidence = evidence_digest(site)
    days: dict[tuple[int, str], list[ArchiveFrame]] = {}
    for frame in frames:
        days.setdefault((frame.day, frame.camera), []).append(frame)
    tasks = []
    for (day, camera), found in sorted(days.items()):
        of_day = tuple(burn for burn in burns if burn.stamp_ns // DAY_NS == day)
        for begin in range(0, len(found), frames_per_task):
            chunk = tuple(found[begin : begin + frames_per_task])
            votes = digest(settings.code, of_votes[camera], camera, [frame.identity() for frame in chunk])
            evidence = evidence_key(settings, votes, of_evidence, of_day)
            fusing, measured = of_measured[camera], ""
            if fusing:
                known = [frame.covariance_known for frame in chunk]
                measured = digest(settings.code, fusing, camera, [frame.identity() for frame in chunk], known)
            tasks.append(Task(chunk, of_votes[camera], votes, evidence, of_day, fusing, measured))
    return tasks


def evidence_key(settings: TaskSettings, votes_key: str, of_evidence: str, burns: Sequence[Burn]) -> str:
    """`of_evidence`: `evidence_digest` of the site."""
    return digest(settings.code, votes_key, of_evidence, burns_digest(burns))


def other_files(site: str) -> ArchiveError:
    return ArchiveError(
        f"{site}, or a file that it names, is another one here than where the run was started; give all workers the "
        "same files"
    )


_TRIED = 3
"""Frames of a camera that are worked for the estimate, after one that is worked for the kernels and the network to be
there."""


@dataclass(frozen=True)
class Cost:
    """CPU seconds a frame from picture to votes, and to what the terrain takes where that is worked, the standard error
    of their mean, and bytes of both a frame."""

    cpu_s: float
    error_s: float
    made_bytes: float


def cost_of(frames: Sequence[ArchiveFrame], planned: Plan) -> Cost:
    """Of a camera's frames, from a few of them spread over all; nothing is kept."""
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


def dry_run_table(planned: Plan) -> list[Table]:
    """Frames, gaps and costs by camera; and what could not be taken, with the reason."""
    about = Table(title=f"{len(planned.frames)} frames in {len(planned.tasks)} tasks", caption=_caption(planned))
    for column in ("camera", "frames", "days", "days without", "GB in", "core-hours", "made, MB"):
        about.add_column(column, justify="left" if column == "camera" else "right")
    days = days_of(planned.frames)
    for camera in sorted({frame.camera for frame in planned.frames}):
        frames = [frame for frame in planned.frames if frame.camera == camera]
        its = sorted(day for name, day in days if name == camera)
        cost = cost_of(frames, planned)
        hours, error = (seconds * len(frames) / 3600 for seconds in (cost.cpu_s, cost.error_s))
        about.add_row(
            camera,
            str(len(frames)),
            str(len(its)),
            str(its[-1] - its[0] + 1 - len(its)),
            f"{sum(frame.size_bytes for frame in frames) / 1e9:.3g}",
            f"{hours:.3g} ± {error:.1g}",
            f"{cost.made_bytes * len(frames) / 1e6:.3g}",
        )
    lost = Table(title="not taken")
    for column in ("camera", "cause", "frames", "first reason"):
        lost.add_column(column, overflow="fold")
    for failure in (*planned.manifest.unread, *planned.manifest.failures):
        lost.add_row(failure.place, failure.cause, str(failure.count), failure.why)
    for note in planned.manifest.damage:
        lost.add_row("", "damage", "", note)
    return [about, lost] if lost.row_count else [about]


def _caption(planned: Plan) -> str:
    to = "votes and measured depth, without the terrain's map" if planned.options.terrain else "votes"
    return (
        f"{len(planned.manifest.frames)} frames found, {planned.manifest.repeated} held more than once; core-hours to "
        f"{to}, from {_TRIED} frames of each camera, with the standard error; bytes of {to.partition(',')[0]} as of "
        "single frames"
    )
