"""Reprocess an archive: scan, plan, run the tasks, and merge them into the site's store, layers and a record.

All intermediate files are named by their content, so a stopped run is resumed by running it again."""

from __future__ import annotations

import json
import tempfile
from collections import Counter
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from ltm_core.base.errors import ArchiveError, LtmError
from ltm_core.fuel.export.provenance import software
from ltm_core.fuel.overlays_io import Burn, read_burns
from ltm_core.pipeline.site_surface import STORE_FILE as TERRAIN_FILE
from ltm_core.pipeline.stored_fuel import STORE_FILE, STORE_KIND
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store import TileStore
from ltm_core.surface.tile_pool import KIND as TERRAIN_KIND
from ltm_ros.archive.content_digest import code_digest
from ltm_ros.archive.files import ResultFolder
from ltm_ros.archive.frame_files import LostFrame
from ltm_ros.archive.manifest import ArchiveFrame, ArchiveManifest, Failure, make_manifest, packed
from ltm_ros.archive.plan import (
    EVIDENCE,
    MEASURED,
    Task,
    TaskSettings,
    evidence_name,
    measured_name,
    node_rules,
    plan,
    refuse_terrain,
)
from ltm_ros.archive.publish import RUN, publish
from ltm_ros.archive.reduction import Reduction, TerrainFold, reduce_to_store, store_digest
from ltm_ros.archive.sampling import Sample, chosen
from ltm_ros.archive.scan import first_message, recordings, scan
from ltm_ros.archive.task import Engine
from ltm_ros.recordings.inputs import beside_expected, warn_of_ignored

MANIFEST = "manifest.parquet"
_NAMED = 1000
"""Number of failures that the record lists one by one; all are counted."""


@dataclass(frozen=True)
class ArchiveOptions:
    """Options of a run. `since_ns`, `until_ns`: stamps, both inclusive. `max_failed`: share of all frames that may be
    lost before sampling, and of the sampled ones after. `burns`: GeoJSON of burns with times. `terrain`: also
    compute the terrain, and apply its changes to the fuel map."""

    archives: tuple[Path, ...]
    site: Path
    out: Path
    cameras: tuple[str, ...] = ()
    since_ns: int | None = None
    until_ns: int | None = None
    sample: Sample = field(default_factory=Sample)
    frames_per_task: int = 1500
    max_failed: float = 0.001
    burns: Path | None = None
    terrain: bool = False


@dataclass(frozen=True)
class Plan:
    """A scanned archive."""

    options: ArchiveOptions
    site: Site
    results: ResultFolder
    settings: TaskSettings
    manifest: ArchiveManifest
    frames: tuple[ArchiveFrame, ...]
    """Frames to process, of those in the manifest."""
    passed_over: Counter[str]
    """Images that the sampling found not clear, by reason."""
    tasks: tuple[Task, ...]
    burns: tuple[Burn, ...] = ()


@dataclass(frozen=True)
class Summary:
    """Result of a run. `worked`: frames processed from image to votes in this run; `digest`: of the map's store, empty
    if none was made; `terrain_digest`, `terrain_frames`: of the terrain's, and its number of frames."""

    tasks: int
    worked: int
    merged: int
    failures: tuple[Failure, ...]
    unused: dict[str, int]
    digest: str = ""
    terrain_digest: str = ""
    terrain_frames: int = 0

    @property
    def failed(self) -> int:
        return sum(failure.count for failure in self.failures)


def look_through(options: ArchiveOptions, progress: Callable[[int, int], None]) -> Plan:
    """Scan an archive. `progress`: files scanned, of how many. Raises LtmError for an archive that cannot
    be processed."""
    site = load_site(options.site)
    if options.terrain:
        refuse_terrain(site)
    grid = site.in_crs(site.fuel_geometry(site.open_dem()))
    # Before a scan of hours, because a file of burns may be invalid.
    burns = () if options.burns is None else tuple(read_burns(options.burns, grid))
    cameras = options.cameras or tuple(site.cameras)
    results = ResultFolder(options.out)
    found = recordings(options.archives)
    scans, unread = [], []
    for number, recording in enumerate(found, start=1):
        try:
            scans.append(scan(recording, site, results))
        except (LtmError, OSError) as error:
            unread.append(Failure(recording.name, "unread", str(error)))
        progress(number, len(found))
    rules = node_rules(site, options.site, cameras[0])
    manifest = make_manifest(scans, site, cameras, rules.manifest)
    manifest.unread = unread
    warn_of_ignored(site, partial(first_message, scans))
    since, until = options.since_ns or 0, options.until_ns or 2**63 - 1
    frames = [frame for frame in manifest.frames if since <= frame.stamp_ns <= until]
    passed = Counter[str]()
    if options.sample.count:
        frames, passed = chosen(manifest.frames, (since, until), options.sample, site, results)
    settings = TaskSettings(
        str(options.site.resolve()),
        results.folder,
        code_digest(),
        rules.tracing,
        rules.labelling,
        rules.fusing if options.terrain else None,
    )
    results.write(MANIFEST, packed(frames))
    tasks = plan(frames, site, settings, options.frames_per_task, burns)
    return Plan(options, site, results, settings, manifest, tuple(frames), passed, tuple(tasks), burns)


def run(planned: Plan, engine: Engine, progress: Callable[[int, int], None]) -> Summary:
    """Process the remaining tasks and make the map. `progress`: tasks done, of how many.

    Raises ArchiveError if too many frames failed, or there is none, before a map is written; the record of the run is
    written."""
    results = planned.results
    if not planned.frames and not planned.manifest.unread:
        results.write(RUN, _record(planned, Summary(0, 0, 0, tuple(planned.manifest.failures), {})))
        raise ArchiveError(_no_frames(planned))
    tasks = planned.tasks
    done = {f"{folder}/{name}" for folder in (EVIDENCE, MEASURED) for name in results.names(folder)}
    waiting = [task for task in tasks if not done.issuperset(task.files)]
    worked, broken = 0, dict[str, Failure]()
    progress(len(tasks) - len(waiting), len(tasks))
    for number, ended in enumerate(engine(waiting, planned.settings) if waiting else (), start=1):
        progress(len(tasks) - len(waiting) + number, len(tasks))
        if ended.report is None:
            broken[ended.task.evidence_key] = Failure(ended.task.label, "task", ended.error, len(ended.task.frames))
        else:
            worked += ended.report.worked
    failures = (*planned.manifest.unread, *planned.manifest.failures, *broken.values())
    mapped = Summary(len(tasks), worked, 0, failures, {})
    return _reduced(planned, mapped, set(broken))


def _reduced(planned: Plan, mapped: Summary, broken: set[str]) -> Summary:
    results = planned.results
    whole = [task for task in planned.tasks if task.evidence_key not in broken]
    dem = planned.site.open_dem()  # shared by all readers while it is held: each day needs an image
    with tempfile.TemporaryDirectory(prefix="ltm-archive-") as folder, nullcontext(dem):
        path = Path(folder) / STORE_FILE

        def read(task: Task) -> bytes:
            return results.read(evidence_name(task))

        terrain = None
        if planned.options.terrain:
            opened = path.with_name(TERRAIN_FILE)
            terrain = TerrainFold(planned.site, opened, lambda task: results.open(measured_name(task)))
        try:
            found = reduce_to_store(whole, read, planned.site, path, planned.burns, terrain)
        finally:
            if terrain is not None:
                terrain.close()
        failures = (*mapped.failures, *_lost(found, terrain))
        summary = Summary(mapped.tasks, mapped.worked, found.counted.total(), failures, dict(found.unused))
        if refused := _too_many_failed(planned, failures) or _empty(summary):
            results.write(RUN, _record(planned, summary))
            raise ArchiveError(refused)
        with TileStore.open_read_only(path, STORE_KIND) as store:
            summary = replace(summary, digest=store_digest(store))
        if terrain is not None:
            with TileStore.open_read_only(path.with_name(TERRAIN_FILE), TERRAIN_KIND) as store:
                summary = replace(summary, terrain_digest=store_digest(store), terrain_frames=terrain.frames)
        told = publish(results, planned.site, path, None if terrain is None else path.with_name(TERRAIN_FILE))
        results.write(RUN, _record(planned, summary, told))  # last
    return summary


def _too_many_failed(planned: Plan, failures: tuple[Failure, ...]) -> str:
    """Return why no map may be written, or nothing. Frames lost before sampling count as a share of all frames."""
    manifest, most = planned.manifest, planned.options.max_failed
    if manifest.unread:
        first = manifest.unread[0]
        return (
            f"{len(manifest.unread)} recordings could not be read, with an unknown number of frames: no map was "
            f"written; {planned.results.folder}/{RUN} lists them, the first is {first.place} ({first.why}); run "
            "again, or remove invalid files from ARCHIVES"
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
                f"{planned.results.folder}/{RUN} lists them; to accept more, raise --max-failed"
            )
    return ""


def _no_frames(planned: Plan) -> str:
    """Return why there is no frame, with the archive's topics beside the expected ones."""
    manifest, options = planned.manifest, planned.options
    if manifest.frames:
        passed = ", ".join(f"{count} {reason}" for reason, count in planned.passed_over.items())
        return (
            f"none of {len(manifest.frames)} frames is usable in the given time span and sample"
            f"{f' ({passed})' if passed else ''}: no map was written; change --since, --until or --sample"
        )
    lost = (f"{lost.place}: {lost.count} x {lost.cause}: {lost.why}" for lost in manifest.failures[:5])
    beside = beside_expected(planned.site, manifest.recorded, options.cameras)
    return f"no frame was found, no map was written: {'; '.join((*lost, beside))}"


def _empty(summary: Summary) -> str:
    if summary.merged:
        return ""
    why = "; ".join(
        (
            *(f"{count} x {reason}" for reason, count in summary.unused.items()),
            *(f"{lost.place}: {lost.count} x {lost.cause}: {lost.why}" for lost in summary.failures[:5]),
        )
    )
    why = why or "none shows a cell of the fuel map; check the poses and the DEM's extent"
    return f"no frame reached the map, none was written: {why}"


def _lost(found: Reduction, terrain: TerrainFold | None) -> list[Failure]:
    """Count lost frames; one without votes and measurement counts once."""
    first: dict[tuple[str, int], LostFrame] = {}
    for lost in (*found.lost, *(terrain.lost if terrain is not None else ())):
        first.setdefault((lost.camera, lost.stamp_ns), lost)
    return [Failure("frame", lost.cause, lost.why) for lost in first.values()]


def _terrain_record(planned: Plan, summary: Summary) -> dict[str, object] | str:
    if not planned.options.terrain:
        return "not computed: without --terrain"
    return {"frames": summary.terrain_frames, "digest": summary.terrain_digest}


def _record(planned: Plan, summary: Summary, about: dict[str, Any] | None = None) -> bytes:
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
            "unchanged": planned.manifest.unchanged,
            "chosen": len(planned.frames),
            "passed_over": planned.passed_over,
            "worked_now": summary.worked,
            "merged": summary.merged,
            "failed": summary.failed,
            "unused": summary.unused,
        },
        "burns": [{"stamp_ns": burn.stamp_ns, "cells": len(burn.cells)} for burn in planned.burns],
        "terrain": _terrain_record(planned, summary),
        "max_failed": options.max_failed,
        "failures": [asdict(failure) for failure in summary.failures[:_NAMED]],
        "damage": planned.manifest.damage,
        "tasks": [{"of": t.label, "frames": len(t.frames), "files": t.files} for t in planned.tasks],
        "digest": summary.digest,
        **(about or {}),
    }
    return json.dumps(record, indent=1).encode()
