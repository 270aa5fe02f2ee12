"""Count the votes of all tasks into a site's store, in the order of the plan, and publish the map with its layers.

A node can continue from the store: tiles with their sources, counted frames, and a journal of the days."""

import hashlib
import json
import shutil
from collections import Counter, defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import ArchiveError, RasterError
from ltm_core.base.number_text import DAY_NS
from ltm_core.base.resources import config_path
from ltm_core.fuel.evidence import TILE
from ltm_core.fuel.overlays_io import Burn
from ltm_core.fuel.prior import system_of
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.pipeline.stored_fuel import STORE_FILE, fuel_schema
from ltm_core.site.site import Site
from ltm_core.storage.tile_store import Key, TileStore
from ltm_core.storage.tile_store_schema import FrameRecord
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.onnx_file import file_digest
from ltm_ros.archive.manifest import Failure
from ltm_ros.archive.plan import Task
from ltm_ros.archive.scan import write_result
from ltm_ros.archive.task import read_result
from ltm_ros.fuel_map.export import export_site
from ltm_ros.fuel_map.layers import ShownLayers
from ltm_ros.fuel_map.source import FuelSource

LAYERS, LANDSCAPE = "layers", "landscape.tif"
RUN = "run.json"
STORES = "stores.json"
"""SHA-256 of the stores that runs have written. A node continues from a store with another one."""


def reduce_to_store(
    tasks: Sequence[Task], results: Path, site: Site, path: Path, burns: Sequence[Burn] = ()
) -> tuple[int, list[Failure], Counter[str]]:
    """Write the store into `path`, which must not exist; return the number of frames with votes for a cell, the lost
    frames, and the number of unused ones by reason. `burns`: by time; each is applied on its day.

    Raises LtmError for evidence that does not fit the site, StoreError if the store cannot be written."""
    geometry = site.fuel_geometry(site.open_dem())
    evidence = site_evidence_map(site, geometry, LabelSet.load(config_path(site.labels)))
    shown, touched = ShownLayers(evidence), set[Key]()
    merged, lost, unused = 0, list[Failure](), Counter[str]()
    of_days = defaultdict[int, list[Task]](list)
    for task in tasks:
        of_days[task.frames[0].day].append(task)
    with TileStore.open(path, fuel_schema(site, geometry)) as store:
        for day in sorted({*of_days, *(burn.stamp_ns // DAY_NS for burn in burns)}):
            for burn in (burn for burn in burns if burn.stamp_ns // DAY_NS == day):
                evidence.burn(burn.mask(geometry.shape), burn.stamp_ns)
                rows, cols = np.divmod(burn.cells, geometry.width)
                touched.update(zip((rows // TILE).tolist(), (cols // TILE).tolist(), strict=True))
            records = []
            for task in of_days[day]:
                found, model, failed, useless = read_result(results / task.file, geometry)
                lost += failed
                unused.update(useless)
                for votes in found:
                    if (window := evidence.add(votes)) is not None:
                        tiles = evidence.tiles_of(window)
                        touched.update(tiles)
                        records.append(FrameRecord(votes.source, votes.stamp_ns, tiles, model))
            merged += len(records)
            store.commit({}, records, shown.refresh_all())
        store.commit({key: evidence.tile_state(key) for key in sorted(touched)}, last=True)
    return merged, lost, unused


def store_digest(store: TileStore) -> str:
    """Return the digest of a map's content: all tiles, their sources, and the counted frames per source.

    The journal is excluded: a live node writes it frame by frame, an archive day by day."""
    found = hashlib.sha256(store.schema.described().encode())
    for key, tile in store.tiles():
        found.update(repr((key, store.touches(key))).encode())
        for name in sorted(tile):
            found.update(name.encode())
            found.update(tile[name].tobytes())
    found.update(repr(store.sources()).encode())
    return found.hexdigest()


def publish(results: Path, site: Site, store: Path) -> dict[str, Any]:
    """Publish the map in `store`; return its part of the run's record, which is removed before and written last. Raises
    ArchiveError if a node has continued from an existing store."""
    former = _own_store(results)
    layers, landscape = store.with_name(LAYERS), store.with_name(LANDSCAPE)
    layers.mkdir()
    said = LANDSCAPE
    with FuelSource.open(store, site) as map_:
        system = system_of(map_.prior).value
        export_site(map_, layers, None, "layers", system, None, None)
        try:
            export_site(map_, landscape, None, "landscape", system, None, None)
        except RasterError as error:  # without a prior, most cells may have no fuel model
            said = f"not written: {error}"
    (results / RUN).unlink(missing_ok=True)
    shutil.rmtree(results / LAYERS, ignore_errors=True)
    for file in sorted(layers.iterdir()):
        write_result(results / LAYERS / file.name, file)
    (results / LANDSCAPE).unlink(missing_ok=True)
    if landscape.exists():
        write_result(results / LANDSCAPE, landscape)
    # Before the store: an interrupted run must recognise its own.
    content = file_digest(store)
    write_result(results / STORES, json.dumps([former, content]).encode())
    write_result(results / STORE_FILE, store)
    return {"store": content, "landscape": said}


def _own_store(results: Path) -> str:
    """Return the SHA-256 of the existing store; empty: none. Raises ArchiveError if no run has written it."""
    if not (results / STORE_FILE).exists():
        return ""
    found, known = file_digest(results / STORE_FILE), results / STORES
    if not known.exists() or found not in json.loads(known.read_bytes()):
        what = f"{results / STORE_FILE} is not what the last run wrote: a node may have continued from it"
        raise ArchiveError(f"{what}; move it away or give another folder")
    return found
