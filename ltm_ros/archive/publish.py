"""Writes the maps of an archive to where they are wanted: stores, layers, landscape and page."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, BinaryIO

from ltm_core.errors import ArchiveError, RasterError
from ltm_core.fuel.prior import system_of
from ltm_core.fuel.stored_map import STORE_FILE
from ltm_core.site import Site
from ltm_core.terrain.site_terrain import STORE_FILE as TERRAIN_FILE
from ltm_ros.archive.page import write_page
from ltm_ros.archive.results import ResultFolder
from ltm_ros.fuel_map.export import export_site
from ltm_ros.fuel_map.source import FuelSource

LAYERS, MAPS, LANDSCAPE = "layers", "maps", "landscape.tif"
RUN = "run.json"
STORES = "stores.json"
"""SHA-256 of the stores that are there and of those that take their place: those that runs have written. A node goes on
from a store of another."""


def publish(results: ResultFolder, site: Site, store: Path, terrain: Path | None) -> dict[str, Any]:
    """The files of the map in `store` and, where it was worked, of the terrain's store; what the record of the run says
    of them. Raises ArchiveError where a node has gone on from a store that is there."""
    former = [_own_store(results, name) for name in (STORE_FILE, TERRAIN_FILE)]
    out = store.parent / "out"
    landscape = _write_map(store, site, out)
    written = {file.relative_to(out).as_posix(): file for file in sorted(out.rglob("*")) if file.is_file()}
    if results.has(RUN):  # of what is written over from here on
        results.remove(RUN)
    for name, file in written.items():
        results.put(file, name)
    for folder in (LAYERS, MAPS):  # days and layers of a former run that this one has not
        for name in results.names(folder) - {file.name for file in (out / folder).iterdir()}:
            results.remove(f"{folder}/{name}")
    stores = {STORE_FILE: store} | ({} if terrain is None else {TERRAIN_FILE: terrain})
    contents = {}
    for name, file in stores.items():
        with file.open("rb") as content:
            contents[name] = sha256_of(content)
    # Before the stores: a run that is killed in between shall know its own.
    results.write(STORES, json.dumps([*former, *contents.values()]).encode())
    for name, file in stores.items():
        results.put(file, name)
    if terrain is None and results.has(TERRAIN_FILE):
        results.remove(TERRAIN_FILE)  # of a former run: a node would tell this map of what another one knows
    return {"stores": contents, "files": sorted(written), "landscape": landscape}


def _write_map(store: Path, site: Site, out: Path) -> str:
    """Layers, landscape and page; the landscape's name, or why there is none."""
    (out / LAYERS).mkdir(parents=True)
    (out / MAPS).mkdir()
    landscape = LANDSCAPE
    with FuelSource.open(store, site) as map_:
        system = system_of(map_.prior).value
        export_site(map_, out / LAYERS, None, "layers", system, None, None)
        try:
            export_site(map_, out / LANDSCAPE, None, "landscape", system, None, None)
        except RasterError as error:  # without a prior, most cells may have no fuel model
            landscape = f"not written: {error}"
        write_page(map_, out / MAPS)
    return landscape


def sha256_of(file: BinaryIO) -> str:
    """Of a file's content from here on, read in pieces."""
    found = hashlib.sha256()
    while piece := file.read(1 << 20):
        found.update(piece)
    return found.hexdigest()


def _own_store(results: ResultFolder, name: str) -> str:
    """SHA-256 of the store that is there; empty: none. Raises ArchiveError where no run has written it."""
    if not results.has(name):
        return ""
    with results.open(name) as file:
        found = sha256_of(file)
    if not results.has(STORES) or found not in json.loads(results.read(STORES)):
        raise ArchiveError(
            f"{results.url}/{name} is not what the last run wrote: a node may have gone on from it; move it away "
            "or name another folder"
        )
    return found
