"""Reprocess an archive: scan, plan, run the tasks, and merge them into the site's store, layers and a record.

All intermediate files are named by their content, so a stopped run is resumed by running it again."""

import json
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from ltm_core.base.errors import ArchiveError, LtmError
from ltm_core.fuel.export.provenance import software
from ltm_core.fuel.overlays_io import Burn, read_burns
from ltm_core.pipeline.stored_fuel import STORE_FILE, STORE_KIND
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.storage.tile_store import TileStore
from ltm_ros.archive.manifest import ArchiveFrame, ArchiveManifest, Failure, make_manifest
from ltm_ros.archive.plan import Task, TaskSettings, code_digest, node_rules, plan
from ltm_ros.archive.reduction import RUN, publish, reduce_to_store, store_digest
from ltm_ros.archive.sampling import Sample, chosen
from ltm_ros.archive.scan import Scan, first_message, recordings, scan, write_result
from ltm_ros.archive.task import Engine
from ltm_ros.recordings.inputs import beside_expected, warn_of_ignored

_NAMED = 1000
"""Number of failures that the record lists one by one; all are counted."""


@dataclass(frozen=True)
class ArchiveOptions:
    """Options of a run. `since_ns`, `until_ns`: stamps, both inclusive. `max_failed`: share of all frames that may be
    lost before sampling, and of the sampled ones after. `burns`: GeoJSON of burns with times."""

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


@dataclass(frozen=True)
class Plan:
    """A scanned archive."""

    options: ArchiveOptions
    site: Site
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
    """Result of a run. `worked`: frames processed in this run; `digest`: of the map's store, empty if none was made."""

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
    """Scan an archive. `progress`: files scanned, of how many. Raises LtmError for an unusable archive."""
    site = load_site(options.site)
    grid = site.in_crs(site.fuel_geometry(site.open_dem()))
    # Before a scan of hours, because a file of burns may be invalid.
    burns = () if options.burns is None else tuple(read_burns(options.burns, grid))
    cameras = options.cameras or tuple(site.cameras)
    for name in cameras:
        site.camera(name)
    results = options.out.expanduser().resolve()
    found = recordings(options.archives)
    scans, unread = list[Scan](), list[Failure]()
    for number, recording in enumerate(found, start=1):
        try:
            scans.append(scan(recording, site, results))
        except (LtmError, OSError) as error:
            unread.append(Failure(str(recording), "unread", str(error)))
        progress(number, len(found))
    rules, limits, tracing, labelling = node_rules(site, options.site, cameras[0])
    manifest = make_manifest(scans, site, cameras, rules, limits)
    manifest.unread = unread
    warn_of_ignored(site, partial(first_message, scans))
    since, until = options.since_ns or 0, options.until_ns or 2**63 - 1
    frames = [frame for frame in manifest.frames if since <= frame.stamp_ns <= until]
    passed = Counter[str]()
    if options.sample.count:
        frames, passed = chosen(frames, options.sample, site, results)
    path = str(options.site.resolve())
    settings = TaskSettings(path, results, code_digest(), tracing, labelling)
    tasks = plan(frames, site, settings, options.frames_per_task)
    return Plan(options, site, settings, manifest, tuple(frames), passed, tuple(tasks), burns)


def run(planned: Plan, engine: Engine, progress: Callable[[int, int], None]) -> Summary:
    """Process the remaining tasks and make the map. `progress`: tasks done, of how many.

    Raises ArchiveError if too many frames failed, or there is none; then no map, but the record is written."""
    results = planned.settings.results
    if not planned.frames and not planned.manifest.unread:
        _write_record(planned, Summary(0, 0, 0, tuple(planned.manifest.failures), {}))
        raise ArchiveError(_no_frames(planned))
    tasks = planned.tasks
    waiting = [task for task in tasks if not (results / task.file).exists()]
    worked, broken = 0, dict[str, Failure]()
    progress(len(tasks) - len(waiting), len(tasks))
    for number, ended in enumerate(engine(waiting, planned.settings) if waiting else (), start=1):
        progress(len(tasks) - len(waiting) + number, len(tasks))
        worked += ended.worked
        if ended.error:
            broken[ended.task.key] = Failure(ended.task.label, "task", ended.error, len(ended.task.frames))
    failures = (*planned.manifest.unread, *planned.manifest.failures, *broken.values())
    whole = [task for task in tasks if task.key not in broken]
    dem = planned.site.open_dem()  # shared by all readers while it is held: each day needs an image
    with tempfile.TemporaryDirectory(prefix="ltm-archive-") as folder, nullcontext(dem):
        store = Path(folder) / STORE_FILE
        merged, lost, unused = reduce_to_store(whole, results, planned.site, store, planned.burns)
        failures = (*failures, *lost)
        summary = Summary(len(tasks), worked, merged, failures, dict(unused))
        if refused := _too_many_failed(planned, failures) or _empty(summary):
            _write_record(planned, summary)
            raise ArchiveError(refused)
        with TileStore.open_read_only(store, STORE_KIND) as opened:
            summary = replace(summary, digest=store_digest(opened))
        _write_record(planned, summary, publish(results, planned.site, store))
    return summary


def _too_many_failed(planned: Plan, failures: tuple[Failure, ...]) -> str:
    """Return why no map may be written, or nothing. Frames lost before sampling count as a share of all frames."""
    manifest, most = planned.manifest, planned.options.max_failed
    listed = f"no map was written; {planned.settings.results}/{RUN} lists them"
    if manifest.unread:
        first = manifest.unread[0]
        which = f"{listed}, the first is {first.place} ({first.why}); run again, or remove invalid files"
        return f"{len(manifest.unread)} recordings could not be read, with an unknown number of frames: {which}"
    joining, working = manifest.failures, failures[len(manifest.failures) :]
    found = len(manifest.frames) + sum(failure.count for failure in joining)
    for lost, total in ((joining, found), (working, len(planned.frames))):
        causes = Counter[str]()
        for failure in lost:
            causes[failure.cause] += failure.count
        if causes.total() > most * total:
            named = ", ".join(f"{count} {cause}" for cause, count in causes.most_common())
            why = f"{causes.total()} of {total} frames failed ({named}), more than {most:.4%}"
            return f"{why}: {listed}; to accept more, raise --max-failed"
    return ""


def _no_frames(planned: Plan) -> str:
    """Return why there is no frame, with the archive's topics beside the expected ones."""
    manifest = planned.manifest
    if manifest.frames:
        passed = ", ".join(f"{count} {reason}" for reason, count in planned.passed_over.items()) or "none seen"
        which = f"none of {len(manifest.frames)} frames is usable in the given time span and sample ({passed})"
        return f"{which}: no map was written; change --since, --until or --sample"
    beside = beside_expected(planned.site, manifest.recorded, planned.options.cameras)
    return f"no frame was found, no map was written: {'; '.join((*_named(manifest.failures), beside))}"


def _empty(summary: Summary) -> str:
    unused = (f"{count} x {reason}" for reason, count in summary.unused.items())
    why = "; ".join((*unused, *_named(summary.failures)))
    why = why or "none shows a cell of the fuel map; check the poses and the DEM's extent"
    return "" if summary.merged else f"no frame reached the map, none was written: {why}"


def _named(failures: Sequence[Failure]) -> list[str]:
    return [f"{lost.place}: {lost.count} x {lost.cause}: {lost.why}" for lost in failures[:5]]


def _write_record(planned: Plan, summary: Summary, about: dict[str, Any] | None = None) -> None:
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
        "max_failed": options.max_failed,
        "failures": [asdict(failure) for failure in summary.failures[:_NAMED]],
        "damage": planned.manifest.damage,
        "tasks": [{"of": t.label, "frames": len(t.frames), "file": t.file} for t in planned.tasks],
        "digest": summary.digest,
        **(about or {}),
    }
    write_result(planned.settings.results / RUN, json.dumps(record, indent=1).encode())
