"""The tasks of an archive, a camera's day each, and the names of what they make: digests of all that goes into it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ltm_core.base.errors import ArchiveError
from ltm_core.base.utc_time import DAY_NS
from ltm_core.fuel.overlays_io import Burn
from ltm_core.pipeline.frame_steps import LabellingConfig, TracingConfig
from ltm_core.pipeline.fusing_step import FusingConfig
from ltm_core.site.site import Site
from ltm_ros.archive.content_digest import burns_digest, digest, evidence_digest, measured_digest, votes_digest
from ltm_ros.archive.files import CacheConfig
from ltm_ros.archive.manifest import ArchiveFrame

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
        """Return all files that exist when it is done."""
        measured = (measured_name(self),) if self.measured_key else ()
        return (evidence_name(self), *measured)

    @property
    def label(self) -> str:
        """Return camera and day, for messages."""
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
    """Return tasks in the order of days, then cameras. Chunks of a day depend only on the order of its frames."""
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
        f"{site}, or a file that it names, differs from that of the run; give all workers the same files"
    )
