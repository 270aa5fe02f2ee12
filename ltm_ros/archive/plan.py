"""Plan an archive's tasks, a camera's day each: the node parameters from the site file, and the names of results, which
are digests of all that goes into them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import ArchiveError
from ltm_core.base.number_text import DAY_NS
from ltm_core.fuel.overlays_io import Burn
from ltm_core.pipeline.frame_steps import LabellingConfig, TracingConfig
from ltm_core.pipeline.fusing_step import FusingConfig
from ltm_core.site.site import Site
from ltm_core.storage.config_io import checked
from ltm_ros.archive.content_digest import burns_digest, digest, evidence_digest, measured_digest, votes_digest
from ltm_ros.archive.manifest import ArchiveFrame, ManifestRules
from ltm_ros.launching.graph import describe
from ltm_ros.runtime.frame_join import FrameJoinConfig

VOTES, EVIDENCE, MEASURED = "votes", "evidence", "measured"
"""Folders of results."""


@dataclass(frozen=True)
class TaskSettings:
    """What all tasks of a run share. `site`: path of the site file; `results`: a folder; `fusing`: how frames are
    measured, None where they are not."""

    site: str
    results: Path
    code: str
    tracing: TracingConfig
    labelling: LabellingConfig
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
    return ArchiveError(f"{site}, or a file that it names, has changed during the run; run again")


@dataclass(frozen=True)
class NodeRules:
    """Parameters of a site's nodes for joining, tracing and labelling; `fusing`: None without a depth network."""

    manifest: ManifestRules
    tracing: TracingConfig
    labelling: LabellingConfig
    fusing: FusingConfig | None


def node_rules(site: Site, path: Path, camera: str) -> NodeRules:
    """Return the parameters, with the nodes' defaults. Raises ConfigError."""
    from ltm_ros.fuel_map.services import FuelMapConfig

    graph = describe(site, path)

    def given(label: str) -> dict[str, Any]:
        return {k: v for k, v in graph.node(label).parameters.items() if k != "use_sim_time"}

    def only(model: type[Any], label: str) -> Any:
        values = {name: value for name, value in given(label).items() if name in model.model_fields}
        return checked(model, values, f"parameters of {label}")

    fuel_map = checked(FuelMapConfig, given("fuel_map"), "parameters of fuel_map")
    join = only(FrameJoinConfig, f"{camera}/capture")
    rules = ManifestRules(join, fuel_map.max_ahead, fuel_map.max_behind)
    fusing = only(FusingConfig, f"{camera}/topodepth") if site.depth_model else None
    return NodeRules(
        rules, only(TracingConfig, f"{camera}/depth"), only(LabellingConfig, f"{camera}/segmentation"), fusing
    )


def refuse_terrain(site: Site) -> None:
    """Raise ArchiveError with the remedy for a site whose terrain cannot be reprocessed."""
    if site.terrain is None:
        raise ArchiveError(f"site {site.name} has no section `terrain`: add one, or run without --terrain")
    if not site.depth_model or site.nodes.get("terrain", {}).get("depth_from_elsewhere"):
        raise ArchiveError(
            f"site {site.name}: the terrain of an archive needs depth from a network: set `depth_model` to a "
            "depth network, without depth_from_elsewhere, or run without --terrain"
        )
    if site.terrain.trace_confirmed:
        raise ArchiveError(
            f"site {site.name} traces depth to the confirmed surface (terrain.trace_confirmed): a frame's votes "
            "then depend on earlier frames. Remove the setting for the archive, or run without --terrain"
        )
