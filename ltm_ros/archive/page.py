"""A page with the maps of an archive through time: what the fuel map said at the end of days on which it changed."""

from __future__ import annotations

import html
import json
from pathlib import Path

import numpy as np

from ltm_core.fuel.prior import system_of
from ltm_core.fuel.stored_map import JOURNALED
from ltm_core.utc_time import DAY_NS, moment_of_stamp
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
