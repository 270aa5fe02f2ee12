"""Run one task of an archive: a camera's day, from frames to votes to evidence, without middleware or other tasks.

Each step writes a file named by the digest of its inputs. An existing file is valid, whoever wrote it; its step is not
repeated.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ltm_core.base.errors import ArchiveError
from ltm_core.base.resources import config_path
from ltm_core.fuel.evidence import EvidenceMap
from ltm_core.fuel.evidence_merge import PartialEvidence
from ltm_core.fuel.overlays_io import Burn
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pipeline.site_fuel import empty_maps
from ltm_core.pipeline.stored_fuel import fuel_schema
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store_schema import Key
from ltm_core.vision.labels import LabelSet
from ltm_ros.archive.content_digest import code_digest, evidence_digest
from ltm_ros.archive.files import ResultFolder
from ltm_ros.archive.frame_files import ABOUT, LostFrame, frame_files, packed_table, read_packed, read_votes
from ltm_ros.archive.plan import (
    MEASURED,
    VOTES,
    Task,
    TaskSettings,
    evidence_key,
    evidence_name,
    measured_name,
    other_files,
    votes_name,
)

_TILES = pa.schema(
    [("row", pa.int32()), ("col", pa.int32()), ("content", pa.binary()), ("stamps", pa.list_(pa.int64()))]
)


@dataclass(frozen=True)
class TaskReport:
    """Result of a task: number of frames whose images were read, 0 if all files existed."""

    worked: int


@dataclass(frozen=True, eq=False)
class TaskEvidence:
    """`touched`: tile -> stamps of its frames. `lost`: frames that failed; `unused`: reason -> number of frames with
    unusable images.
    """

    partial: PartialEvidence
    touched: dict[Key, list[int]]
    model: str
    lost: tuple[LostFrame, ...]
    unused: dict[str, int]


def work(task: Task, settings: TaskSettings) -> TaskReport:
    """Run the missing steps. Raises ArchiveError if this worker's program or files differ from those of the run,
    OSError if results cannot be read or written now.
    """
    if (own := code_digest()) != settings.code:
        raise ArchiveError(
            f"this worker's program has the digest {own}, the run's is {settings.code}: install the same version "
            "on all workers"
        )
    results = ResultFolder(settings.results)
    votes, evidence = votes_name(task), evidence_name(task)
    done = results.has(evidence)
    wanted = [] if done or results.has(votes) else [VOTES]
    wanted += [MEASURED] if task.measured_key and not results.has(measured_name(task)) else []
    worked = 0
    if wanted:
        made, names = frame_files(task, settings, wanted), {VOTES: votes, MEASURED: measured_name(task)}
        for kind in wanted:
            results.write(names[kind], made[kind])
        worked = len(task.frames)
    if done:
        return TaskReport(worked)
    of_evidence = evidence_digest(load_site(settings.site))
    if evidence_key(settings, task.votes_key, of_evidence, task.burns) != task.evidence_key:
        raise other_files(settings.site)
    results.write(evidence, _evidence_file(results.read(votes), _ground(settings.site, of_evidence), task.burns))
    return TaskReport(worked)


@dataclass(frozen=True, eq=False)
class _Ground:
    """The basis of evidence, the same for all tasks of a run. `empty` makes maps without evidence."""

    site: Site
    labels: LabelSet
    geometry: GridGeometry
    empty: Callable[[], EvidenceMap]


@lru_cache(maxsize=1)
def _ground(site: str, of_evidence: str) -> _Ground:
    """Load the basis. `of_evidence`: digest of its files now."""
    found = load_site(site)
    labels, geometry = LabelSet.load(config_path(found.labels)), found.fuel_geometry(found.open_dem())
    return _Ground(found, labels, geometry, empty_maps(found, geometry, labels))


def _evidence_file(votes: bytes, ground: _Ground, burns: Sequence[Burn]) -> bytes:
    """Write one row per tile: its state, and the stamps of its frames."""
    labels, geometry, evidence = ground.labels, ground.geometry, ground.empty()
    for burn in burns:
        evidence.burn(burn.mask(geometry.shape), burn.stamp_ns)
    touched: dict[Key, list[int]] = {}
    for found in read_votes(votes, geometry, labels):
        window = evidence.add(found)
        for key in evidence.tiles_of(window) if window is not None else ():
            touched.setdefault(key, []).append(found.stamp_ns)
    about = json.loads(pq.read_schema(io.BytesIO(votes)).metadata[ABOUT.encode()])
    unused: dict[str, int] = {}
    for frame in about.pop("frames"):
        if frame["reason"]:
            unused[frame["reason"]] = unused.get(frame["reason"], 0) + 1
    schema = fuel_schema(ground.site, geometry)
    rows = [
        {"row": key[0], "col": key[1], "content": schema.pack(key, evidence.tile_state(key)), "stamps": stamps}
        for key, stamps in sorted(touched.items())
    ]
    return packed_table(pa.Table.from_pylist(rows, _TILES), about | {"unused": unused})


def read_evidence(content: bytes, site: Site, geometry: GridGeometry) -> TaskEvidence:
    """Read the evidence file of a task; `geometry`: the fuel grid in the map frame. Raises ConfigError if it is
    corrupt.
    """
    table, schema = read_packed(content), fuel_schema(site, geometry)
    about = json.loads(table.schema.metadata[ABOUT.encode()])
    tiles, touched = {}, {}
    for row in table.to_pylist():
        key = row["row"], row["col"]
        tiles[key], touched[key] = schema.unpack(row["content"]), row["stamps"]
    stamps = sorted({stamp for found in touched.values() for stamp in found})
    known = {about["camera"]: np.array(stamps, np.int64)} if stamps else {}
    lost = tuple(LostFrame(**one) for one in about["lost"])
    return TaskEvidence(PartialEvidence(known, tiles), touched, about["model"], lost, about["unused"])
