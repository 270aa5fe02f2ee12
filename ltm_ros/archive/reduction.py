"""Makes a site's store of the evidence of all tasks: each merged once, by the list of the plan, day by day.

The store is one that a node opens and goes on from: its tiles, whom they were touched by, the frames that are counted,
and a journal of what the map said at the end of each day.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ltm_core.fuel.burns_io import Burn
from ltm_core.fuel.evidence_merge import merged_parts
from ltm_core.fuel.evidence_state import TILE
from ltm_core.fuel.site_map import site_evidence_map
from ltm_core.fuel.stored_map import fuel_schema
from ltm_core.raster.tile_store import CellChanges, FrameRecord, Key, TileStore
from ltm_core.resources import config_path
from ltm_core.site import Site
from ltm_core.utc_time import DAY_NS
from ltm_core.vision.labels import LabelSet
from ltm_ros.archive.frame_files import LostFrame
from ltm_ros.archive.plan import Task
from ltm_ros.archive.task import TaskEvidence, read_evidence
from ltm_ros.archive.terrain_fold import TerrainFold
from ltm_ros.fuel_map.layers import ShownLayers


@dataclass
class Reduction:
    """`counted`: frames that say something of a cell, by camera; `lost`, `unused` as of the tasks."""

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
    """Write the store into `path`, where nothing must be yet. `read`: the content of a task's evidence file. `burns`:
    by their times; each is told when its day comes, so that the journal's days before it know nothing of it. `terrain`:
    what it has found by the end of a day is told then: what cameras had seen until then where it has changed is void.

    Raises LtmError for evidence that does not fit the site, StoreError where the store cannot be written.
    """
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
    """Of what a map is made of: the state of all tiles, who touched them, and how many frames of whom are counted.

    The journal is left out: a live node writes it frame by frame, an archive day by day.
    """
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
