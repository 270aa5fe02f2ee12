"""Writes what a fire shows: pictures, GeoTIFF, KMZ, figures, and a page that says what the update changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ltm_core.fire.fire_io import write_fire
from ltm_core.fire.scenario import FireScenario
from ltm_core.fuel.export.kmz_io import write_kmz
from ltm_core.pictures import to_png
from ltm_core.pictures.fire_maps import arrival_overlay, fire_sheet
from ltm_ros.fire.before_after import FireResult, MapPair
from ltm_ros.pages.figures_io import write_figures
from ltm_ros.pages.render import render_page

FILES = ("index.html", "fire.png", "fire.tif", "fire.kmz", "fire.json")
NO_FORECAST = (
    "This is no forecast. One wind blows the whole time, nobody fights the fire, embers start no new ones, and the "
    "moisture is what was assumed. It shows what the update of the map means for a fire model, and nothing else."
)


def write_results(out: Path, pair: MapPair, scenario: FireScenario, result: FireResult) -> None:
    """Everything of `FILES` into a folder. Raises ConfigError where it cannot be written."""
    out.mkdir(parents=True, exist_ok=True)
    effect, geometry = result.effect, pair.after.geometry
    start = scenario.row, scenario.col
    (out / "fire.png").write_bytes(to_png(fire_sheet(effect, pair.after, start)))
    told = facts(pair, scenario, result)
    tags = {} if pair.made is None else {f"map_{k}": v for k, v in pair.made.tags().items() if "TIFFTAG" not in k}
    tags |= {name.replace(" ", "_"): value for name, value in told.items()} | {"note": NO_FORECAST}
    write_fire(out / "fire.tif", effect, geometry, tags)
    picture, legend = arrival_overlay(effect, pair.after)
    title = f"a fire on the map of {pair.name} as it is, no forecast"
    write_kmz(out / "fire.kmz", picture, geometry, title, legend, pair.made, "arrival of the fire")
    write_figures(out / "fire.json", figures(pair, scenario, result))
    page = render_page(
        "fire.html",
        {},
        title=f"A fire on the map of {pair.name}, before and after",
        warning=NO_FORECAST,
        said=sentences(pair, result),
        areas=effect.areas(),
        facts=told,
        made="" if pair.made is None else pair.made.line(),
        files=FILES[1:],
        was=pair.was,
    )
    (out / "index.html").write_text(page, encoding="utf-8")


def facts(pair: MapPair, scenario: FireScenario, result: FireResult) -> dict[str, str]:
    x, y = (float(v) for v in pair.after.geometry.to_map(scenario.row, scenario.col))
    told = {
        "ignition": f"{x:.0f}, {y:.0f}",
        "wind": scenario.wind.described(),
        "moisture": scenario.moisture.described(),
        "hours": f"{scenario.hours:g}",
        "fire model": f"{result.model}, surface and crown fire (Rothermel; Cruz, Alexander and Wakimoto), no spotting",
        "fuel models": pair.after.system.value.upper(),
        "cells that changed": f"{int(result.effect.changed.sum()):,}".replace(",", " "),
        "map as it was": pair.was,
    }
    if result.effect.members:
        told["drawn landscapes"] = str(len(result.effect.members))
    return told


def figures(pair: MapPair, scenario: FireScenario, result: FireResult) -> dict[str, Any]:
    effect = result.effect
    return {
        **facts(pair, scenario, result),
        "areas_ha": [vars(area) for area in effect.areas()],
        "first_contact_h": effect.first_contact(),
        "edge_h": effect.after.reaches_edge(),
        "seconds_per_fire": list(result.seconds),
        "mean_burn_probability": None if effect.probability is None else float(effect.probability.mean()),
        "note": NO_FORECAST,
    }


def sentences(pair: MapPair, result: FireResult) -> list[str]:
    """What the update changes, in plain words."""
    effect = result.effect
    last = effect.areas()[-1]
    contact, edge = effect.first_contact(), effect.after.reaches_edge()
    said = []
    if not effect.changed.any():
        said.append("Nothing has changed on the map: both fires are the same.")
    elif contact is None:
        said.append("The fire does not come to any cell that has changed: what was updated does not matter to it.")
    else:
        more = last.after - last.before
        word, now = "more" if more > 0 else "less", f"{last.after:.0f} ha on the map as it is"
        said.append(
            f"The fire comes to changed fuel after {contact:.1f} h. After {last.hours:g} h it has burned {now}, "
            f"{abs(more):.0f} ha {word} than on the map as it was ({last.before:.0f} ha)."
        )
    if edge is not None:
        said.append(f"It reaches the edge of the landscape after {edge:.1f} h; from then on hectares are too few.")
    if last.ensemble is not None:
        low, middle, high = last.ensemble
        said.append(
            f"Of {len(effect.members)} landscapes drawn from what is known of the fuel, eight in ten burn {low:.0f} to "
            f"{high:.0f} ha ({middle:.0f} in the middle): that is what the doubt about fuel means for this fire."
        )
    return said
