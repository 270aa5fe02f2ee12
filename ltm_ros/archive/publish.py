"""Write the map of an archive with its layers.

A run's record lists which files were published. It is removed before any of them is replaced, and written last."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, BinaryIO

from ltm_core.base.errors import ArchiveError, RasterError
from ltm_core.fuel.prior import system_of
from ltm_core.pipeline.site_surface import STORE_FILE as TERRAIN_FILE
from ltm_core.pipeline.stored_fuel import STORE_FILE
from ltm_core.site.site import Site
from ltm_ros.archive.files import ResultFolder
from ltm_ros.fuel_map.export import export_site
from ltm_ros.fuel_map.source import FuelSource

LAYERS, LANDSCAPE = "layers", "landscape.tif"
RUN = "run.json"
STORES = "stores.json"
"""SHA-256 of existing stores and their replacements, all written by runs. A node continues from a store with another
one."""


def publish(results: ResultFolder, site: Site, store: Path, terrain: Path | None) -> dict[str, Any]:
    """Publish the map in `store` and, if used, the terrain's store; return their part of the run's record. Raises
    ArchiveError if a node has continued from an existing store."""
    former = [_own_store(results, name) for name in (STORE_FILE, TERRAIN_FILE)]
    out = store.parent / "out"
    landscape = _write_map(store, site, out)
    written = {file.relative_to(out).as_posix(): file for file in sorted(out.rglob("*")) if file.is_file()}
    if results.has(RUN):  # of what is replaced from here on
        results.remove(RUN)
    for name, file in written.items():
        results.put(file, name)
    for name in results.names(LAYERS) - {file.name for file in (out / LAYERS).iterdir()}:  # of an earlier run
        results.remove(f"{LAYERS}/{name}")
    stores = {STORE_FILE: store} | ({} if terrain is None else {TERRAIN_FILE: terrain})
    contents = {}
    for name, file in stores.items():
        with file.open("rb") as content:
            contents[name] = sha256_of(content)
    # Before the stores: an interrupted run must recognise its own.
    results.write(STORES, json.dumps([*former, *contents.values()]).encode())
    for name, file in stores.items():
        results.put(file, name)
    if terrain is None and results.has(TERRAIN_FILE):
        results.remove(TERRAIN_FILE)  # of an earlier run: a node would apply another map's knowledge to this one
    return {"stores": contents, "files": sorted(written), "landscape": landscape}


def _write_map(store: Path, site: Site, out: Path) -> str:
    """Write layers and landscape; return the landscape's name, or why there is none."""
    (out / LAYERS).mkdir(parents=True)
    landscape = LANDSCAPE
    with FuelSource.open(store, site) as map_:
        system = system_of(map_.prior).value
        export_site(map_, out / LAYERS, None, "layers", system, None, None)
        try:
            export_site(map_, out / LANDSCAPE, None, "landscape", system, None, None)
        except RasterError as error:  # without a prior, most cells may have no fuel model
            landscape = f"not written: {error}"
    return landscape


def sha256_of(file: BinaryIO) -> str:
    """Return the SHA-256 of the rest of a file, read in pieces."""
    found = hashlib.sha256()
    while piece := file.read(1 << 20):
        found.update(piece)
    return found.hexdigest()


def _own_store(results: ResultFolder, name: str) -> str:
    """Return the SHA-256 of the existing store; empty: none. Raises ArchiveError if no run has written it."""
    if not results.has(name):
        return ""
    with results.open(name) as file:
        found = sha256_of(file)
    if not results.has(STORES) or found not in json.loads(results.read(STORES)):
        raise ArchiveError(
            f"{results.folder}/{name} is not what the last run wrote: a node may have continued from it; move it "
            "away or give another folder"
        )
    return found
