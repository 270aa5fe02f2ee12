"""Write the maps of an archive and the page that shows them over time; find whether they are current.

Whether the map that is there is the one that a run would make again: then nothing is left to do.

A run's record says of what its map was made and which files were published; it is taken away before any of them is
written over, and comes last.
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
from ltm_ros.archive.results import ResultFolder
from ltm_ros.fuel_map.export import export_site
from ltm_ros.fuel_map.source import FuelSource

PAGE = "index.html"
_MOST = 24
"""Maps on the page; of more days those spread over all, the last among them."""

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
    """Pictures and `index.html` into an existing folder; nothing where no frame changed any cell.

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
    """Dates, rising, at whose end the map was another one than before."""
    assert map_.store is not None  # nosec B101 # an archive's map is a store
    store = map_.store
    changed = sorted({change.stamp_ns // DAY_NS for layer in JOURNALED for change in store.changes(layer)})
    kept = np.linspace(0, len(changed) - 1, min(len(changed), _MOST)).round().astype(int)
    return [moment_of_stamp(changed[i] * DAY_NS).date().isoformat() for i in kept]


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
            f"{results.url}/{name} is not what the last run wrote: a node may have continued from it; move it "
            "away or give another folder"
        )
    return found


def map_digest(
    site: Site, files: Sequence[str], burns: Sequence[Burn], terrain: bool, allowed: Sequence[object]
) -> str:
    """Of all that a map and what is written of it hang on. Raises LtmError for files of the site that are not there.

    Args:
        files: results of the tasks, whose names tell what they hold, in the order of the plan.
        allowed: the share that may fail, and what has failed until then.
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
    """The record of the run that made just this map, if all of it is there: its stores by their content, and by name
    what people read."""
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
    except (ValueError, LookupError, TypeError, ArchiveError):  # of another version, or spoiled: the map is made again
        return None
