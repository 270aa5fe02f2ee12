"""Merge the evidence and the measured frames of all tasks into a site's stores, in the order of the plan.

The terrain map depends on the order of frames, so it is computed in one place, from the tasks' measured frames in the
order of their stamps, as in a replay. At the end of each day its changes go to the fuel map.

A node can open the store and continue from it: its tiles with their sources, the counted frames, and a journal with the
map at the end of each day."""

from __future__ import annotations

import hashlib
import heapq
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ltm_core.base.errors import LtmError, StoreError
from ltm_core.base.number_text import DAY_NS
from ltm_core.base.resources import config_path
from ltm_core.fuel.cell_state import TILE
from ltm_core.fuel.evidence_merge import merged_parts
from ltm_core.fuel.overlays_io import Burn
from ltm_core.fuel.surface_change import SOURCE, LivingFuelMap
from ltm_core.pipeline.fusing_step import MeasuredFrame
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.site_surface import UNCOMMITTED, SiteTerrain, terrain_grid
from ltm_core.pipeline.stored_fuel import SurfaceMoves, fuel_schema, take_news
from ltm_core.site.site import Site
from ltm_core.storage.tile_store import Key, TileStore
from ltm_core.storage.tile_store_schema import CellChanges, FrameRecord
from ltm_core.vision.labels import LabelSet
from ltm_ros.archive.frame_files import LostFrame, lost_of_measured, read_measured
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.plan import Task
from ltm_ros.archive.task import TaskEvidence, read_evidence
from ltm_ros.fuel_map.layers import ShownLayers
from ltm_ros.runtime.health import cause_of

OpenMeasured = Callable[[Task], AbstractContextManager[BinaryIO]]
"""Opens the file of a task's measured frames."""


class TerrainFold:
    """Writes the terrain's store into `path`, which must not exist.

    Raises ConfigError for a site without a terrain, StoreError if the store cannot be written."""

    def __init__(self, site: Site, path: Path, open_measured: OpenMeasured) -> None:
        self._terrain = SiteTerrain(site, lambda schema: TileStore.open(path, schema))
        assert site.terrain is not None  # nosec B101 # tells the type checker what holds
        self._moves = SurfaceMoves(terrain_grid(site.open_dem().geometry, site.terrain.resolution))
        self._open = open_measured
        self.frames = 0
        """Number of frames used."""
        self.lost: list[LostFrame] = []
        """Frames without measured data, or whose data could not be used."""

    def take_day(self, tasks: Sequence[Task]) -> None:
        """Add the frames of a day's tasks. Raises StoreError; ArchiveError, OSError if a file cannot be read now."""
        surface = self._terrain.map
        for frame, measured in measured_frames(tasks, self._open, self.lost):
            self._take(frame, measured)
            self._moves.take(surface.decide())
            if surface.uncommitted >= UNCOMMITTED:
                surface.commit()

    def tell(self, evidence: LivingFuelMap) -> tuple[list[FrameRecord], list[CellChanges]]:
        """Apply the changes found so far to a fuel map and its store."""
        surface = self._terrain.map
        window = surface.seen_window()
        if window is None:
            return [], []
        news = self._moves.news(surface.layers(window).told, window, evidence)
        if not len(news):
            return [], []
        taken = take_news(evidence, news, surface.newest_ns)
        for key, tile in taken.tiles.items():
            evidence.load_tile(key, tile)
        return [FrameRecord(SOURCE, surface.newest_ns, sorted(taken.tiles))], [taken.change]

    def close(self) -> None:
        """Write everything. Raises StoreError."""
        self._terrain.map.commit(last=True)
        self._terrain.map.close()

    def _take(self, frame: ArchiveFrame, measured: MeasuredFrame) -> None:
        try:
            self._terrain.add(
                measured.depth,
                measured.sigma,
                frame.calibration,
                frame.pose,
                frame.stamp_ns,
                frame.camera,
                frame.known_covariance,
                measured.labels,
            )
        except StoreError:
            raise
        except LtmError as error:
            why = f"terrain: {error} ({frame.file}, stamp {frame.stamp_ns} ns)"
            self.lost.append(LostFrame(frame.camera, frame.stamp_ns, cause_of(error), why))
        else:
            self.frames += 1


def measured_frames(
    tasks: Sequence[Task], open_measured: OpenMeasured, lost: list[LostFrame]
) -> Iterator[tuple[ArchiveFrame, MeasuredFrame]]:
    """Yield measured frames in the order of stamps, and of log times for equal stamps, as in a replay. `lost` gets the
    frames without data. One file per camera is open at a time, and one frame is held."""
    of_cameras: dict[str, list[Task]] = {}
    for task in tasks:
        of_cameras.setdefault(task.frames[0].camera, []).append(task)
    streams = [_of_camera(its, open_measured, lost) for its in of_cameras.values()]
    yield from heapq.merge(*streams, key=lambda found: (found[0].stamp_ns, found[0].log_time_ns, found[0].camera))


def _of_camera(
    tasks: Sequence[Task], open_measured: OpenMeasured, lost: list[LostFrame]
) -> Iterator[tuple[ArchiveFrame, MeasuredFrame]]:
    for task in tasks:
        frames = {frame.stamp_ns: frame for frame in task.frames}
        with open_measured(task) as file:
            lost += lost_of_measured(file)
            for stamp, measured in read_measured(file):
                yield frames[stamp], measured


@dataclass
class Reduction:
    """`counted`: frames with votes for a cell, by camera; `lost`, `unused` as of the tasks."""

    counted: Counter[str] = field(default_factory=Counter)
    lost: list[LostFrame] = field(default_factory=list)
    unused: Counter[str] = field(default_factory=Counter)
    newest_ns: int = 0


def reduce_to_store(
    tasks: Sequence[Task],
    read: Callable[[Task], bytes],
    site: Site,
    path: Path,
    burns: Sequence[Burn] = (),
    terrain: TerrainFold | None = None,
) -> Reduction:
    """Write the store into `path`, which must not exist. `read`: reads a task's evidence file. `burns`: by time; each
    is applied on its day, so that the journal before it is unaffected. `terrain`: its changes are applied at the end of
    each day, and void earlier evidence of the changed cells.

    Raises LtmError for evidence that does not fit the site, StoreError if the store cannot be written."""
    geometry = site.fuel_geometry(site.open_dem())
    evidence = site_evidence_map(site, geometry, LabelSet.load(config_path(site.labels)))
    shown, found, touched = ShownLayers(evidence), Reduction(), set[Key]()
    days: dict[int, tuple[list[Task], list[Burn]]] = {}
    for task in tasks:
        days.setdefault(task.frames[0].day, ([], []))[0].append(task)
    for burn in burns:
        days.setdefault(burn.stamp_ns // DAY_NS, ([], []))[1].append(burn)
    with TileStore.open(path, fuel_schema(site, geometry)) as store:
        for _, (of_day, burned) in sorted(days.items()):
            for burn in burned:
                evidence.burn(burn.mask(geometry.shape), burn.stamp_ns)
                rows, cols = np.divmod(burn.cells, geometry.width)
                touched.update(zip((rows // TILE).tolist(), (cols // TILE).tolist(), strict=True))
            parts = [read_evidence(read(task), site, geometry) for task in of_day]
            merged = merged_parts(part.partial for part in parts)
            merged.after(evidence).merge_into(evidence)
            records = [record for part in parts for record in _records(part)]
            for part in parts:
                found.lost += part.lost
                found.unused.update(part.unused)
                touched.update(part.touched)
            found.counted.update(record.source for record in records)
            news, changes = list[FrameRecord](), list[CellChanges]()
            if terrain is not None:
                terrain.take_day(of_day)
                news, changes = terrain.tell(evidence)
                touched.update(key for record in news for key in record.tiles)
            store.commit({}, [*records, *news], [*changes, *shown.refresh_all()])
        tiles = {key: evidence.tile_state(key) for key in sorted(touched)}
        store.commit(tiles, last=True)
    found.newest_ns = evidence.newest_ns
    return found


def store_digest(store: TileStore) -> str:
    """Return the digest of a map's content: the state of all tiles, their sources, and the number of counted frames per
    source.

    The journal is excluded: a live node writes it frame by frame, an archive day by day."""
    found = hashlib.sha256(store.schema.described().encode())
    for key, tile in store.tiles():
        found.update(repr((key, store.touches(key))).encode())
        for name in sorted(tile):
            found.update(name.encode())
            found.update(tile[name].tobytes())
    found.update(repr(store.sources()).encode())
    return found.hexdigest()


def _records(one: TaskEvidence) -> Iterator[FrameRecord]:
    tiles: dict[int, list[Key]] = {}
    for key, stamps in one.touched.items():
        for stamp in stamps:
            tiles.setdefault(stamp, []).append(key)
    for camera, counted in one.partial.stamps.items():
        yield from (FrameRecord(camera, stamp, tiles[stamp], one.model) for stamp in counted.tolist())
