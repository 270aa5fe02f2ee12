"""One task of an archive: a camera's day, from frames to votes to evidence. Needs no middleware and no other task.

Each step has a file of its own, named by the digest of all that went into it. A file that is there is right, whoever
wrote it and when; a step whose file is there is not done again.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ltm_core.errors import ArchiveError, LtmError
from ltm_core.frame import PosedImage
from ltm_core.frame_steps import FrameSteps, LabellingConfig, TracingConfig
from ltm_core.fuel.burns_io import Burn
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.evidence_merge import PartialEvidence
from ltm_core.fuel.site_map import empty_maps
from ltm_core.fuel.stored_map import fuel_schema
from ltm_core.fuel.vote_columns import columns_to_votes
from ltm_core.fuel.votes import CellVotes
from ltm_core.grid import GridGeometry
from ltm_core.named_columns import Columns
from ltm_core.raster.tile_store_schema import Key
from ltm_core.resources import config_path
from ltm_core.site import Site
from ltm_core.site_io import load_site
from ltm_core.vision.labels import LabelSet
from ltm_ros.archive.content_digest import code_digest, digest, evidence_digest, votes_digest
from ltm_ros.archive.files import ArchiveFiles, CacheConfig
from ltm_ros.archive.manifest import DAY_NS, ArchiveFrame
from ltm_ros.archive.pictures import PictureReader
from ltm_ros.archive.results import ResultFolder
from ltm_ros.runtime.health import cause_of

VOTES, EVIDENCE = "votes", "evidence"
_ABOUT = "ltm"
"""Of a file's metadata: what it holds, as JSON."""
_TILES = pa.schema(
    [("row", pa.int32()), ("col", pa.int32()), ("content", pa.binary()), ("stamps", pa.list_(pa.int64()))]
)


@dataclass(frozen=True)
class TaskSettings:
    """What all tasks of a run share. `site`: path of the site file, the same for all workers; `results`: URL; `cache`:
    where a worker puts files of archives on stores."""

    site: str
    results: str
    code: str
    tracing: TracingConfig
    labelling: LabellingConfig
    cache: CacheConfig = field(default_factory=CacheConfig)


@dataclass(frozen=True)
class Task:
    """Some frames of one camera and day, in the order of their stamps, and the names of the files of its two steps.

    `steps_key`: of what makes votes of the camera's frames (`votes_digest`). `burns`: of that day.
    """

    frames: tuple[ArchiveFrame, ...]
    steps_key: str
    votes_key: str
    evidence_key: str
    burns: tuple[Burn, ...] = ()

    @property
    def label(self) -> str:
        """For people: camera and day."""
        first = self.frames[0]
        return f"{first.camera} {np.datetime64(first.day, 'D')}"


@dataclass(frozen=True)
class LostFrame:
    """A frame of which there are no votes, and why."""

    stamp_ns: int
    cause: str
    why: str


@dataclass(frozen=True)
class TaskReport:
    """What was worked: frames from picture to votes, 0 where they were there."""

    worked: int


@dataclass(frozen=True, eq=False)
class TaskEvidence:
    """`touched`: tile -> stamps of the frames that touch it. `lost`: frames that failed; `unused`: reason -> number of
    those whose picture shows too little."""

    partial: PartialEvidence
    touched: dict[Key, list[int]]
    model: str
    lost: tuple[LostFrame, ...]
    unused: dict[str, int]


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
            evidence = _evidence_key(settings, votes, of_evidence, of_day)
            tasks.append(Task(chunk, of_votes[camera], votes, evidence, of_day))
    return tasks


def _evidence_key(settings: TaskSettings, votes_key: str, of_evidence: str, burns: Sequence[Burn]) -> str:
    told = [[burn.stamp_ns, burn.cells.tolist()] for burn in burns]
    return digest(settings.code, votes_key, of_evidence, told)


def work(task: Task, settings: TaskSettings) -> TaskReport:
    """Do what is not done yet. Raises ArchiveError where this worker's program or files of the site are others than
    those of the run, OSError where results cannot be read or written just now."""
    if (own := code_digest()) != settings.code:
        raise ArchiveError(
            f"this worker's program has the digest {own}, that of the run is {settings.code}: install the same version "
            "on all workers"
        )
    results = ResultFolder(settings.results)
    votes, evidence = f"{VOTES}/{task.votes_key}.parquet", f"{EVIDENCE}/{task.evidence_key}.parquet"
    if results.has(evidence):
        return TaskReport(0)
    worked = 0
    if not results.has(votes):
        results.write(votes, votes_file(task, settings))
        worked = len(task.frames)
    of_evidence = evidence_digest(load_site(settings.site))
    if _evidence_key(settings, task.votes_key, of_evidence, task.burns) != task.evidence_key:
        raise _other_files(settings.site)
    results.write(evidence, _evidence_file(results.read(votes), _ground(settings.site, of_evidence), task.burns))
    return TaskReport(worked)


def votes_file(task: Task, settings: TaskSettings) -> bytes:
    """The file of a task's votes: one row a cell that a frame sees, `frame` its number among those that the file's
    metadata lists. Raises ArchiveError where a picture cannot be read any more: no result may say that it is lost."""
    camera = task.frames[0].camera
    steps = _steps(settings.site, camera, settings.tracing, settings.labelling, task.steps_key)
    parts, listed, lost = list[Columns](), list[dict[str, object]](), list[LostFrame]()
    with PictureReader(ArchiveFiles(settings.cache)) as reader:
        for frame in task.frames:
            picture = reader.read(frame)
            try:
                posed = PosedImage(picture.rgb(), frame.calibration, frame.pose, frame.stamp_ns, camera)
                found = steps.votes(posed, frame.pose_covariance)
            except LtmError as error:
                why = f"{error} ({frame.file}, stamp {frame.stamp_ns} ns)"
                lost.append(LostFrame(frame.stamp_ns, cause_of(error), why))
                continue
            number = np.full(len(found.columns["x"]), len(listed), np.uint32)
            parts.append({"frame": number, **found.columns})
            listed.append({"stamp_ns": frame.stamp_ns, "reason": found.reason})
    about = {"camera": camera, "model": steps.described, "frames": listed, "lost": [asdict(one) for one in lost]}
    return _parquet(pa.table(_stacked(parts)), about)


def _stacked(parts: Sequence[Columns]) -> Columns:
    """All rows; of a class that a frame does not see, it has no pixels."""
    kinds = {name: column.dtype for part in parts for name, column in part.items()}
    return {
        name: np.concatenate([part.get(name, np.zeros(len(part["frame"]), kind)) for part in parts])
        for name, kind in kinds.items()
    }


def _parquet(table: pa.Table, about: Mapping[str, object]) -> bytes:
    file = io.BytesIO()
    pq.write_table(table.replace_schema_metadata({_ABOUT: json.dumps(about)}), file, compression="zstd")
    return file.getvalue()


def read_votes(content: bytes, geometry: GridGeometry, labels: LabelSet) -> Iterator[CellVotes]:
    """The votes of a file's frames, in its order. Raises MessageError for those on another grid."""
    table = pq.read_table(io.BytesIO(content))
    about = json.loads(table.schema.metadata[_ABOUT.encode()])
    columns = {name: table[name].to_numpy() for name in table.column_names}
    bounds = np.searchsorted(columns.pop("frame", np.zeros(0)), np.arange(len(about["frames"]) + 1))
    for frame, begin, end in zip(about["frames"], bounds, bounds[1:], strict=False):
        of_frame = {name: column[begin:end] for name, column in columns.items()}
        yield columns_to_votes(of_frame, geometry, labels.names, frame["stamp_ns"], about["camera"])


@dataclass(frozen=True, eq=False)
class _Ground:
    """What evidence is made on: the same for all tasks of a run. `empty` makes maps without any."""

    site: Site
    labels: LabelSet
    geometry: GridGeometry
    empty: Callable[[], EvidenceMap]


@lru_cache(maxsize=1)
def _ground(site: str, of_evidence: str) -> _Ground:
    """`of_evidence`: digest of the files that it is read from, now."""
    found = load_site(site)
    labels, geometry = LabelSet.load(config_path(found.labels)), found.fuel_geometry(found.open_dem())
    return _Ground(found, labels, geometry, empty_maps(found, geometry, labels))


def _evidence_file(votes: bytes, ground: _Ground, burns: Sequence[Burn]) -> bytes:
    """One row a tile: its state, and the stamps of the frames that touch it."""
    labels, geometry, evidence = ground.labels, ground.geometry, ground.empty()
    for burn in burns:
        evidence.burn(burn.mask(geometry.shape), burn.stamp_ns)
    touched: dict[Key, list[int]] = {}
    for found in read_votes(votes, geometry, labels):
        window = evidence.add(found)
        for key in evidence.tiles_of(window) if window is not None else ():
            touched.setdefault(key, []).append(found.stamp_ns)
    about = json.loads(pq.read_schema(io.BytesIO(votes)).metadata[_ABOUT.encode()])
    unused: dict[str, int] = {}
    for frame in about.pop("frames"):
        if frame["reason"]:
            unused[frame["reason"]] = unused.get(frame["reason"], 0) + 1
    schema = fuel_schema(ground.site, geometry)
    rows = [
        {"row": key[0], "col": key[1], "content": schema.pack(key, evidence.tile_state(key)), "stamps": stamps}
        for key, stamps in sorted(touched.items())
    ]
    return _parquet(pa.Table.from_pylist(rows, _TILES), about | {"unused": unused})


def read_evidence(content: bytes, site: Site, geometry: GridGeometry) -> TaskEvidence:
    """The inverse of what a task writes; `geometry`: the fuel grid in the map frame. Raises ConfigError on damage."""
    table, schema = pq.read_table(io.BytesIO(content)), fuel_schema(site, geometry)
    about = json.loads(table.schema.metadata[_ABOUT.encode()])
    tiles, touched = {}, {}
    for row in table.to_pylist():
        key = row["row"], row["col"]
        tiles[key], touched[key] = schema.unpack(row["content"]), row["stamps"]
    stamps = sorted({stamp for found in touched.values() for stamp in found})
    known = {about["camera"]: np.array(stamps, np.int64)} if stamps else {}
    lost = tuple(LostFrame(**one) for one in about["lost"])
    return TaskEvidence(PartialEvidence(known, tiles), touched, about["model"], lost, about["unused"])


@lru_cache(maxsize=2)
def _steps(site: str, camera: str, tracing: TracingConfig, labelling: LabellingConfig, key: str) -> FrameSteps:
    """Raises ArchiveError where this worker's files are others than those of the run."""
    found = load_site(site)
    if votes_digest(found, camera, tracing, labelling) != key:
        raise _other_files(site)
    return FrameSteps(found, camera, tracing, labelling)


def _other_files(site: str) -> ArchiveError:
    return ArchiveError(
        f"{site}, or a file that it names, is another one here than where the run was started; give all workers the "
        "same files"
    )
