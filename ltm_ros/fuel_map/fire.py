"""Run a fire on the previous and the updated map, and write its page."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ltm_core.base.errors import ConfigError
from ltm_core.base.number_text import difference, number
from ltm_core.fire.effect import FireEffect, FireScenario, changed_fuel, read_landscape, require_same_grid, write_fire
from ltm_core.fire.pyretechnics import spread
from ltm_core.fuel.export.companion_files_io import write_kmz
from ltm_core.fuel.export.export_grid import with_fuel
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.fuel.export.provenance import Provenance
from ltm_core.fuel.prior import system_of
from ltm_core.pictures import to_png
from ltm_core.pictures.fire_maps import arrival_overlay, fire_sheet
from ltm_core.site.site_io import load_site
from ltm_ros.fuel_map.source import FuelSource
from ltm_ros.pages import render_page, write_figures


@dataclass(frozen=True, eq=False)
class MapPair:
    """The previous and the updated map. `made`: the map's provenance; None: a file without any."""

    name: str
    was: str
    before: Landscape
    after: Landscape
    made: Provenance | None = None


@dataclass(frozen=True, eq=False)
class FireResult:
    """`model`: name of the fire model. `seconds`: wall time of each of the two fires."""

    effect: FireEffect
    model: str
    seconds: tuple[float, ...]


def open_pair(source: Path, site: Path | None, before: Path | None, since: str | None) -> MapPair:
    """Open a store (.ltm) with its site, as of `since` and now; or two landscape files. Raises LtmError: a store
    without site, a landscape without `before`, two of different grids."""
    if source.suffix == ".ltm":
        if site is None:
            raise ConfigError(
                f"{source} needs the terrain and the prior fuel map of its site: give the site file with --site"
            )
        if before is not None:
            raise ConfigError(f"{source} contains the earlier map: remove --before, or give --since DATE")
        with FuelSource.open(source, load_site(site)) as map_:
            landscape, made, _ = map_.landscape(system_of(map_.prior))
            earlier = with_fuel(landscape, map_.empty if since is None else map_.at(since), map_.prior, map_.climate)
            return MapPair(map_.site.name, "prior map" if since is None else since, earlier, landscape, made)
    if since is not None:
        raise ConfigError("--since needs a store (.ltm), which keeps its history; for files, give --before")
    if before is None:
        raise ConfigError(
            f"{source} is a single landscape: give the earlier one with --before, or the store (.ltm) with --site"
        )
    now, was = read_landscape(source), read_landscape(before)
    require_same_grid(was, now, (before.name, source.name))
    return MapPair(source.name, before.name, was, now)


def run_fires(pair: MapPair, scenario: FireScenario, progress: Callable[[str], None]) -> FireResult:
    """Run the fires. Raises ConfigError if no fire model is installed."""
    seconds, runs, version = [], [], ""
    for name, landscape in (("before", pair.before), ("after", pair.after)):
        progress(f"the fire on the map {name} the update")
        started = time.monotonic()
        run, version = spread(landscape, scenario)
        runs.append(run)
        seconds.append(time.monotonic() - started)
    changed, cell = changed_fuel(pair.before, pair.after), pair.after.geometry.resolution
    effect = FireEffect(runs[0], runs[1], changed, cell, scenario.hours)
    return FireResult(effect, f"Pyretechnics {version}", tuple(seconds))


FILES = ("index.html", "fire.png", "fire.tif", "fire.kmz", "fire.json")
NO_FORECAST = (
    "This is no forecast. Wind and fuel moisture are constant and assumed, there is no suppression and no "
    "spotting. It shows only how the update of the map changes the result of a fire model."
)


def write_results(out: Path, pair: MapPair, scenario: FireScenario, result: FireResult) -> None:
    """Write all `FILES` into a folder. Raises ConfigError if it cannot be written."""
    out.mkdir(parents=True, exist_ok=True)
    effect, geometry = result.effect, pair.after.geometry
    told = facts(pair, scenario, result)
    heading = f"Simulated fire on the map of {pair.name}. " + "; ".join(f"{key}: {told[key]}" for key in _FIRST) + "."
    (out / "fire.png").write_bytes(to_png(fire_sheet(effect, pair.after, scenario, heading)))
    tags = {} if pair.made is None else {f"map_{k}": v for k, v in pair.made.tags().items() if "TIFFTAG" not in k}
    tags |= {name.replace(" ", "_"): value for name, value in told.items()} | {"note": NO_FORECAST}
    write_fire(out / "fire.tif", effect, geometry, tags)
    picture, legend = arrival_overlay(effect, pair.after)
    title = f"a simulated fire on the updated map of {pair.name}, no forecast"
    write_kmz(out / "fire.kmz", picture, geometry, title, legend, pair.made, "arrival of the fire")
    figures = {
        "areas_ha": [vars(area) for area in effect.areas()],
        "first_contact_h": effect.first_contact(),
        "edge_h": effect.after.reaches_edge(),
        "seconds_per_fire": list(result.seconds),
        "note": NO_FORECAST,
    }
    write_figures(out / "fire.json", told | figures)
    page = render_page(
        "fire.html",
        {},
        title=f"A simulated fire on the map of {pair.name}, before and after its update",
        warning=NO_FORECAST,
        said=sentences(pair, result),
        areas=effect.areas(),
        first={key: told[key] for key in _FIRST},
        facts={key: text for key, text in told.items() if key not in _FIRST},
        made="" if pair.made is None else pair.made.line(),
        files=FILES[1:],
        was=pair.was,
    )
    (out / "index.html").write_text(page, encoding="utf-8")


_FIRST = ("ignition", "wind", "fuel moisture", "duration", "map as of")
"""Facts that the first screen and the picture show."""


def facts(pair: MapPair, scenario: FireScenario, result: FireResult) -> dict[str, str]:
    x, y = (float(v) for v in pair.after.geometry.to_map(scenario.row, scenario.col))
    made = pair.made and pair.made.moment()
    return {
        "ignition": f"{x:.0f} m E, {y:.0f} m N in {pair.after.geometry.crs}",
        "wind": scenario.wind.described(),
        "fuel moisture": scenario.moisture.described(),
        "duration": f"{scenario.hours:g} h",
        "map as of": f"{made:%Y-%m-%d %H:%M} UTC" if made else pair.made.as_of if pair.made else "date not known",
        "fire model": f"{result.model}, surface and crown fire (Rothermel; Cruz, Alexander and Wakimoto), no spotting",
        "fuel models": pair.after.system.value.upper(),
        "cells with changed fuel or canopy": number(int(result.effect.changed.sum())),
        "previous map": pair.was,
    }


def sentences(pair: MapPair, result: FireResult) -> list[str]:
    """Return sentences about the effect of the update."""
    effect, said = result.effect, list[str]()
    last, contact, edge = effect.areas()[-1], effect.first_contact(), effect.after.reaches_edge()
    if not effect.changed.any():
        said.append("Fuel and canopy have not changed: both fires are the same.")
    elif contact is None:
        said.append("The fire does not reach changed fuel or canopy, so the update has no effect on it.")
    else:
        more = difference(last.before, last.after)
        word = "as much as" if more == "0" else f"{more.lstrip('+-')} ha {'less' if more < '0' else 'more'} than"
        said.append(
            f"The fire reaches changed fuel or canopy after {contact:.1f} h. After {last.hours:g} h it has burned "
            f"{number(last.after)} ha on the updated map, {word} on the earlier map ({number(last.before)} ha)."
        )
    if edge is not None:
        said.append(f"It reaches the edge of the landscape after {edge:.1f} h; then the burned area is too small.")
    return said
