"""Write the maps of an archive and the page that shows them over time; check whether they are current.

A run's record lists what its map was made of and which files were published. It is removed before any of them is
replaced, and written last.
"""

from __future__ import annotations

import hashlib
import html
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from ltm_core.base.errors import ArchiveError, RasterError
from ltm_core.base.resources import config_path
from ltm_core.base.utc_time import DAY_NS, moment_of_stamp
from ltm_core.fuel.overlays_io import Burn
from ltm_core.fuel.prior import system_of
from ltm_core.pipeline.site_surface import STORE_FILE as TERRAIN_FILE
from ltm_core.pipeline.stored_fuel import JOURNALED, STORE_FILE
from ltm_core.site.site import Site
from ltm_ros.archive.content_digest import (
    burns_digest,
    digest,
    evidence_digest,
    file_digest,
    map_code_digest,
    map_settings,
)
from ltm_ros.archive.files import ResultFolder
from ltm_ros.fuel_map.export import export_site
from ltm_ros.fuel_map.source import FuelSource

PAGE = "index.html"
_MOST = 24
"""Maximum number of maps on the page; of more days a selection spread over all, including the last."""

_HTML = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<style>
body {{ font: 16px/1.5 sans-serif; margin: 2em auto; max-width: 1100px; padding: 0 1em; }}
img {{ max-width: 100%; height: auto; }}
.film {{ display: flex; gap: 1em; align-items: center; }}
.film input {{ flex: 1; }}
output {{ font-variant-numeric: tabular-nums; }}
small {{ color: #555; }}
</style>
<h1>{title}</h1>
<p>The map at the end of {count} days on which it changed, from {first} to {last}: move the slider, or play a film.</p>
<h2>Through time</h2>
<p class="film"><button id="film" type="button">Play</button>
<input id="time" type="range" min="0" max="{most}" value="{most}" aria-label="Day">
<span>End of <output id="day">{last}</output>, UTC</span></p>
<p><img id="map" src="{picture}" alt="Fuel map at the end of the chosen day"></p>
<h2>Before and after</h2>
<p><img src="change.png" alt="The map before any frame beside the map after all, and what has changed"></p>
<p><small>{about}</small></p>
<script>
const days = {days};
// Fetched beforehand: a film waits for no picture.
const pictures = days.map(day => Object.assign(new Image(), {{ src: day + ".png" }}).src);
const time = document.getElementById("time");
const film = document.getElementById("film");
let step = null;
function show() {{
  document.getElementById("day").textContent = days[time.value];
  document.getElementById("map").src = pictures[time.value];
}}
function stop() {{
  clearInterval(step);
  step = null;
  film.textContent = "Play";
}}
time.addEventListener("input", () => {{ stop(); show(); }});
film.addEventListener("click", () => {{
  if (step !== null) {{ stop(); return; }}
  if (+time.value >= days.length - 1) time.value = 0;
  show();
  film.textContent = "Stop";
  step = setInterval(() => {{
    time.value = +time.value + 1;
    show();
    if (+time.value >= days.length - 1) stop();
  }}, 700);
}});
</script>
</html>
"""


def write_page(map_: FuelSource, folder: Path) -> None:
    """Write images and `index.html` into an existing folder; nothing if no frame changed any cell.

    Raises LtmError for a map without a journal.
    """
    days = _days(map_)
    if not days:
        return
    system = system_of(map_.prior).value
    for day in days:
        export_site(map_, folder / f"{day}.png", None, "png", system, day, None)
    export_site(map_, folder / "change.png", None, "change", system, None, None)
    text = _HTML.format(
        title=html.escape(f"Fuel map of {map_.site.name}"),
        about=html.escape(map_.provenance(map_.layers, None).line()),
        count=len(days),
        first=days[0],
        last=days[-1],
        most=len(days) - 1,
        picture=f"{days[-1]}.png",
        days=json.dumps(days),
    )
    (folder / PAGE).write_text(text, encoding="utf-8")


def _days(map_: FuelSource) -> list[str]:
    """Return the dates, rising, after which the map had changed."""
    assert map_.store is not None  # nosec B101 # an archive's map is a store
    store = map_.store
    changed = sorted({change.stamp_ns // DAY_NS for layer in JOURNALED for change in store.changes(layer)})
    kept = np.linspace(0, len(changed) - 1, min(len(changed), _MOST)).round().astype(int)
    return [moment_of_stamp(changed[i] * DAY_NS).date().isoformat() for i in kept]


LAYERS, MAPS, LANDSCAPE = "layers", "maps", "landscape.tif"
RUN = "run.json"
STORES = "stores.json"
"""SHA-256 of existing stores and their replacements, all written by runs. A node continues from a store with another
one.
"""


def publish(results: ResultFolder, site: Site, store: Path, terrain: Path | None) -> dict[str, Any]:
    """Publish the map in `store` and, if used, the terrain's store; return their part of the run's record. Raises
    ArchiveError if a node has continued from an existing store.
    """
    former = [_own_store(results, name) for name in (STORE_FILE, TERRAIN_FILE)]
    out = store.parent / "out"
    landscape = _write_map(store, site, out)
    written = {file.relative_to(out).as_posix(): file for file in sorted(out.rglob("*")) if file.is_file()}
    if results.has(RUN):  # of what is replaced from here on
        results.remove(RUN)
    for name, file in written.items():
        results.put(file, name)
    for folder in (LAYERS, MAPS):  # days and layers of an earlier run that this one lacks
        for name in results.names(folder) - {file.name for file in (out / folder).iterdir()}:
            results.remove(f"{folder}/{name}")
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
    """Write layers, landscape and page; return the landscape's name, or why there is none."""
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


def map_digest(
    site: Site, files: Sequence[str], burns: Sequence[Burn], terrain: bool, allowed: Sequence[object]
) -> str:
    """Return the digest of everything that a map and its files depend on. Raises LtmError for missing files of the
    site.

    Args: files: results of the tasks, named by their content, in the order of the plan. allowed: the share that may
    fail, and what has failed so far.
    """
    burned = burns_digest(burns)
    shipped = file_digest(config_path("fuel")), file_digest(config_path(site.labels))
    return digest(
        map_code_digest(),
        map_settings(site),
        evidence_digest(site),
        shipped,
        list(files),
        burned,
        terrain,
        list(allowed),
    )


def standing_record(results: ResultFolder, made_of: str) -> dict[str, Any] | None:
    """Return the record of the run that made this map, if all its files exist, stores by content and others by name."""
    try:
        record = json.loads(results.read(RUN)) if results.has(RUN) else {}
        if record.get("made_of") != made_of:
            return None
        stores: dict[str, str] = record["stores"]
        files = set(record["files"])
        for name, expected in stores.items():
            if not results.has(name):
                return None
            with results.open(name) as file:
                if sha256_of(file) != expected:
                    return None
        folders = {name.rpartition("/")[0] for name in files}
        there = {f"{folder}/{name}".lstrip("/") for folder in folders for name in results.names(folder)}
        named = sum(failure["count"] for failure in record["failures"])
        return record if files <= there and named == record["frames"]["failed"] else None
    except (ValueError, LookupError, TypeError, ArchiveError):  # of another version, or corrupt: the map is made again
        return None
