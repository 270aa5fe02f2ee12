"""Works an archive again: look through it, plan, map, and reduce to the site's store, layers and a record of the run.

Nothing is kept but files named by what they hold, so a run that was stopped is resumed by running it again.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from ltm_core.errors import ArchiveError, LtmError, RasterError
from ltm_core.fuel.burns_io import Burn, read_burns
from ltm_core.fuel.export.provenance import software
from ltm_core.fuel.prior import system_of
from ltm_core.fuel.stored_map import STORE_FILE, STORE_KIND
from ltm_core.raster.tile_store import TileStore
from ltm_core.site import Site
from ltm_core.site_io import load_site
from ltm_ros.archive.choice import chosen
from ltm_ros.archive.content_digest import code_digest
from ltm_ros.archive.engine import Engine
from ltm_ros.archive.files import ArchiveFiles, CacheConfig
from ltm_ros.archive.manifest import ArchiveFrame, Failure, Manifest, make_manifest, packed
from ltm_ros.archive.node_rules import node_rules
from ltm_ros.archive.page import write_page
from ltm_ros.archive.reduction import Reduction, reduce_to_store, store_digest
from ltm_ros.archive.results import ResultFolder
from ltm_ros.archive.sampling import Sample
from ltm_ros.archive.scan import recordings, scan
from ltm_ros.archive.task import EVIDENCE, Task, TaskSettings, plan
from ltm_ros.fuel_map.export import export_site
from ltm_ros.fuel_map.source import FuelSource

MANIFEST, RUN, LAYERS, MAPS = "manifest.parquet", "run.json", "layers", "maps"
LANDSCAPE = "landscape.tif"
STORES = "stores.json"
"""SHA-256 of the store that is there and of the one that takes its place: those that runs have written. A node goes on
from a store of another."""
_NAMED = 1000
"""Failures that the record of a run names one by one; all are counted."""


@dataclass(frozen=True)
class ArchiveOptions:
    """What to work. `since_ns`, `until_ns`: stamps, both inclusive. `shard`: (i, n), the i-th of n parts of the tasks,
    from 1 on: these are worked, and no map is made. `max_failed`: share of all frames that may be lost before they are
    chosen, and of the chosen ones after. `burns`: GeoJSON of what burned when (`burns_io`)."""

    archives: tuple[str | Path, ...]
    site: Path
    out: str
    cameras: tuple[str, ...] = ()
    since_ns: int | None = None
    until_ns: int | None = None
    sample: Sample = field(default_factory=Sample)
    frames_per_task: int = 1500
    shard: tuple[int, int] = (1, 1)
    max_failed: float = 0.001
    cache: CacheConfig = field(default_factory=CacheConfig)
    burns: Path | None = None


@dataclass(frozen=True)
class Plan:
    """An archive that has been looked through."""

    options: ArchiveOptions
    site: Site
    results: ResultFolder
    settings: TaskSettings
    manifest: Manifest
    frames: tuple[ArchiveFrame, ...]
    """To work, of those in the manifest."""
    passed_over: Counter[str]
    """Pictures that the sampling looked at and found not clear, by reason."""
    tasks: tuple[Task, ...]
    burns: tuple[Burn, ...] = ()


@dataclass(frozen=True)
class Summary:
    """What a run did. `worked`: frames from picture to votes in this run; `digest`: of the map's store, empty where
    none was made."""

    tasks: int
    worked: int
    merged: int
    failures: tuple[Failure, ...]
    unused: dict[str, int]
    digest: str = ""

    @property
    def failed(self) -> int:
        return sum(failure.count for failure in self.failures)


def look_through(options: ArchiveOptions, progress: Callable[[int, int], None]) -> Plan:
    """`progress`: files looked through, of how many. Raises LtmError for what cannot be worked at all."""
    site = load_site(options.site)
    grid = site.in_crs(site.fuel_geometry(site.open_dem()))
    # Before hours of looking through: a file of burns may be wrong.
    burns = () if options.burns is None else tuple(read_burns(options.burns, grid))
    cameras = options.cameras or tuple(site.cameras)
    results = ResultFolder(options.out)
    files, found = ArchiveFiles(options.cache), recordings([str(archive) for archive in options.archives])
    scans, unread = [], []
    for number, recording in enumerate(found, start=1):
        try:
            scans.append(scan(recording, site, results, files))
        except (LtmError, OSError) as error:
            unread.append(Failure(recording.name, "unread", str(error)))
        progress(number, len(found))
    rules, tracing, labelling = node_rules(site, options.site, cameras[0])
    manifest = make_manifest(scans, site, cameras, rules)
    manifest.unread = unread
    since, until = options.since_ns or 0, options.until_ns or 2**63 - 1
    frames = [frame for frame in manifest.frames if since <= frame.stamp_ns <= until]
    passed = Counter[str]()
    if options.sample.count:
        frames, passed = chosen(manifest.frames, (since, until), options.sample, site, results, files)
    settings = TaskSettings(str(options.site.resolve()), results.url, code_digest(), tracing, labelling, options.cache)
    results.write(MANIFEST, packed(frames))
    tasks = plan(frames, site, settings, options.frames_per_task, burns)
    return Plan(options, site, results, settings, manifest, tuple(frames), passed, tuple(tasks), burns)


def run(planned: Plan, engine: Engine, progress: Callable[[int, int], None]) -> Summary:
    """Work what is not done and make the map. `progress`: tasks done, of how many.

    Raises ArchiveError where more failed than may, before any map is written; the record of the run is.
    """
    options, results = planned.options, planned.results
    part, parts = options.shard
    tasks = planned.tasks[part - 1 :: parts]
    done = results.names(EVIDENCE)
    waiting = [task for task in tasks if f"{task.evidence_key}.parquet" not in done]
    worked, broken = 0, dict[str, Failure]()
    progress(len(tasks) - len(waiting), len(tasks))
    for number, ended in enumerate(engine(waiting, planned.settings), start=1):
        progress(len(tasks) - len(waiting) + number, len(tasks))
        if ended.report is None:
            broken[ended.task.evidence_key] = Failure(ended.task.label, "task", ended.error, len(ended.task.frames))
        else:
            worked += ended.report.worked
    failures = (*planned.manifest.unread, *planned.manifest.failures, *broken.values())
    if parts > 1:
        summary = Summary(len(tasks), worked, 0, failures, {})
        results.write(f"run_{part}_of_{parts}.json", _record(planned, summary))
        return summary
    return _reduced(planned, Summary(len(tasks), worked, 0, failures, {}), set(broken))


def _reduced(planned: Plan, mapped: Summary, broken: set[str]) -> Summary:
    results = planned.results
    whole = [task for task in planned.tasks if task.evidence_key not in broken]
    with tempfile.TemporaryDirectory(prefix="ltm-archive-") as folder:
        path = Path(folder) / STORE_FILE

        def read(task: Task) -> bytes:
            return results.read(f"{EVIDENCE}/{task.evidence_key}.parquet")

        found = reduce_to_store(whole, read, planned.site, path, planned.burns)
        failures = (*mapped.failures, *_lost(found))
        summary = Summary(mapped.tasks, mapped.worked, found.counted.total(), failures, dict(found.unused))
        if refused := _too_many_failed(planned, failures):
            results.write(RUN, _record(planned, summary))
            raise ArchiveError(refused)
        with TileStore.open_read_only(path, STORE_KIND) as store:
            summary = replace(summary, digest=store_digest(store))
        _publish(planned, path, summary)
    return summary


def _too_many_failed(planned: Plan, failures: tuple[Failure, ...]) -> str:
    """Why no map may be written, or nothing. What was lost on the way to the manifest is a share of all that archives
    hold, for a sample is chosen of what is left."""
    manifest, most = planned.manifest, planned.options.max_failed
    if manifest.unread:
        first = manifest.unread[0]
        return (
            f"{len(manifest.unread)} recordings could not be read, and nobody knows how many frames they hold: no map "
            f"was written; {planned.results.url}/{RUN} names them, the first is {first.place} ({first.why}); run "
            "again, or leave out of ARCHIVES what is none"
        )
    joining, working = manifest.failures, failures[len(manifest.failures) :]
    found = len(manifest.frames) + sum(failure.count for failure in joining)
    for lost, total in ((joining, found), (working, len(planned.frames))):
        causes = Counter[str]()
        for failure in lost:
            causes[failure.cause] += failure.count
        if causes.total() > most * total:
            named = ", ".join(f"{count} {cause}" for cause, count in causes.most_common())
            return (
                f"{causes.total()} of {total} frames failed ({named}), more than {most:.4%}: no map was written; "
                f"{planned.results.url}/{RUN} names them, --max-failed lets more of them be"
            )
    return ""


def _publish(planned: Plan, store: Path, summary: Summary) -> None:
    """The map's files, and last the record of the run. Raises ArchiveError where a node has gone on from the store."""
    results = planned.results
    former = _own_store(results)
    out = store.parent / "out"
    (out / LAYERS).mkdir(parents=True)
    with FuelSource.open(store, planned.site) as map_:
        system = system_of(map_.prior).value
        export_site(map_, out / LAYERS, None, "layers", system, None, None)
        landscape = LANDSCAPE
        try:
            export_site(map_, out / LANDSCAPE, None, "landscape", system, None, None)
        except RasterError as error:  # without a prior, most cells may have no fuel model
            landscape = f"not written: {error}"
        (out / MAPS).mkdir()
        write_page(map_, out / MAPS)
    for file in sorted(path for path in out.rglob("*") if path.is_file()):
        results.put(file, file.relative_to(out).as_posix())
    for folder in (LAYERS, MAPS):  # days and layers of a former run that this one has not
        for name in results.names(folder) - {file.name for file in (out / folder).iterdir()}:
            results.remove(f"{folder}/{name}")
    written = hashlib.sha256(store.read_bytes()).hexdigest()
    # Before the store: a run that is killed in between shall know its own.
    results.write(STORES, json.dumps([former, written]).encode())
    results.put(store, STORE_FILE)
    results.write(RUN, _record(planned, summary, {"store_sha256": written, "landscape": landscape}))


def _own_store(results: ResultFolder) -> str:
    """SHA-256 of the store that is there; empty: none. Raises ArchiveError where no run has written it."""
    if not results.has(STORE_FILE):
        return ""
    found = hashlib.sha256(results.read(STORE_FILE)).hexdigest()
    if not results.has(STORES) or found not in json.loads(results.read(STORES)):
        raise ArchiveError(
            f"{results.url}/{STORE_FILE} is not what the last run wrote: a node may have gone on from it; move it away "
            "or name another folder"
        )
    return found


def _lost(found: Reduction) -> list[Failure]:
    return [Failure("frame", lost.cause, lost.why) for lost in found.lost]


def _record(planned: Plan, summary: Summary, about: dict[str, str] | None = None) -> bytes:
    options = planned.options
    record: dict[str, Any] = {
        "software": software(),
        "code": planned.settings.code,
        "site": planned.site.name,
        "archives": [str(path) for path in options.archives],
        "cameras": sorted({frame.camera for frame in planned.frames}),
        "sample": options.sample.described,
        "frames": {
            "found": len(planned.manifest.frames),
            "repeated": planned.manifest.repeated,
            "chosen": len(planned.frames),
            "passed_over": planned.passed_over,
            "worked_now": summary.worked,
            "merged": summary.merged,
            "failed": summary.failed,
            "unused": summary.unused,
        },
        "burns": [{"stamp_ns": burn.stamp_ns, "cells": len(burn.cells)} for burn in planned.burns],
        "terrain": "not worked: what the terrain tells the fuel map is none of this",
        "max_failed": options.max_failed,
        "failures": [asdict(failure) for failure in summary.failures[:_NAMED]],
        "damage": planned.manifest.damage,
        "tasks": [{"of": t.label, "frames": len(t.frames), "evidence": t.evidence_key} for t in planned.tasks],
        "digest": summary.digest,
        **(about or {}),
    }
    return json.dumps(record, indent=1).encode()
