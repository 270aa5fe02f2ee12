"""Runs a fire on the map of a site as it was and as it is, and on landscapes drawn from what is known of its fuel."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from ltm_core.base.errors import ConfigError
from ltm_core.fire.effect import (
    CellDoubt,
    FireEffect,
    burn_probability,
    changed_fuel,
    drawn_codes,
    hectares,
    with_codes,
)
from ltm_core.fire.fire_io import read_landscape, require_same_grid
from ltm_core.fire.pyretechnics import Pyretechnics
from ltm_core.fire.scenario import FireScenario
from ltm_core.fuel.export.export_grid import make_landscape, with_fuel
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.fuel.export.provenance import Provenance
from ltm_core.fuel.prior import system_of
from ltm_core.pipeline.site_fuel import spare_heights
from ltm_core.site.site_io import load_site
from ltm_ros.fuel_map.source import FuelSource


@dataclass(frozen=True, eq=False)
class MapPair:
    """A map as it was and as it is. `draw`: makes the landscape of a draw; None: nothing is known of the doubt. `made`:
    what the map says of itself; None: a file of which nothing is known.
    """

    name: str
    was: str
    before: Landscape
    after: Landscape
    draw: Callable[[np.random.Generator], Landscape] | None = None
    made: Provenance | None = None


@dataclass(frozen=True, eq=False)
class FireResult:
    """`model`: that spread the fires. `seconds`: wall time of each, the two and then the draws."""

    effect: FireEffect
    model: str
    seconds: tuple[float, ...]


def open_pair(source: Path, site: Path | None, before: Path | None, since: str | None) -> MapPair:
    """Of a store (.ltm) with its site, as of `since` and now; or of two landscape files.

    Raises LtmError: a store without site, a landscape without `before`, two of different grids.
    """
    if source.suffix == ".ltm":
        if site is None:
            raise ConfigError(
                f"{source} needs the terrain and the prior fuel map of its site: name its file with --site"
            )
        if before is not None:
            raise ConfigError(f"{source} knows what the map was: leave --before away, or give --since DATE")
        return _of_store(source, site, since)
    if since is not None:
        raise ConfigError("--since is for a store (.ltm), which keeps its history; of files, give --before")
    if before is None:
        raise ConfigError(
            f"{source} is one landscape: name the one as it was with --before, or give the store (.ltm) and --site"
        )
    now, was = read_landscape(source), read_landscape(before)
    require_same_grid(was, now, (before.name, source.name))
    return MapPair(source.name, before.name, was, now)


def _of_store(store: Path, site_path: Path, since: str | None) -> MapPair:
    site = load_site(site_path)
    with FuelSource.open(store, site) as map_:
        layers, empty = map_.layers, map_.empty if since is None else map_.at(since)
        evidence, prior, climate = map_.evidence, map_.prior, map_.climate
        system = system_of(prior)
        grid, terrain = site.in_map(map_.geometry), map_.terrain()
        spare, seen = spare_heights(site, grid), map_.canopy(None, terrain).seen
        now = make_landscape(
            layers, prior, terrain.ground, site.frame, map_.geometry, climate, system, spare=spare, seen=seen
        )  # fmt: skip
        was = with_fuel(now, empty, prior, climate)
        made = map_.provenance(layers, terrain.version, None, system, now)
    assert evidence is not None

    @cache  # for the first draw: without an ensemble nobody asks
    def doubt() -> CellDoubt:
        return CellDoubt.of(layers, evidence.alpha(), evidence.rules.mask)

    def draw(rng: np.random.Generator) -> Landscape:
        width, stand = evidence.rules.context_cells, evidence.stand_correlation
        codes = drawn_codes(doubt(), climate, system, rng, width, stand)
        return with_fuel(now, with_codes(layers, codes), prior, climate, seen)

    earlier = "before any camera looked" if since is None else since
    return MapPair(site.name, earlier, was, now, draw, made)


def run_fires(
    pair: MapPair, scenario: FireScenario, ensemble: int, seed: int, progress: Callable[[str], None]
) -> FireResult:
    """Raises ConfigError for an ensemble of maps whose doubt is not known, and where there is no fire model."""
    if ensemble and pair.draw is None:
        raise ConfigError(
            "an ensemble is drawn from what cameras have seen of each cell, which a landscape file does not hold: give "
            "the store (.ltm) and --site, or leave --ensemble away"
        )
    cell, seconds, runs = pair.after.geometry.resolution, [], []
    with Pyretechnics() as model:
        for name, landscape in (("as it was", pair.before), ("as it is", pair.after)):
            progress(f"the fire on the map {name}")
            started = time.monotonic()
            runs.append(model.spread(landscape, scenario))
            seconds.append(time.monotonic() - started)
        effect = FireEffect(runs[0], runs[1], changed_fuel(pair.before, pair.after), cell, scenario.hours)
        members, drawn = [], []
        for k in range(ensemble):
            assert pair.draw is not None
            progress(f"drawn landscape {k + 1} of {ensemble}")
            landscape = pair.draw(np.random.default_rng([seed, k]))
            started = time.monotonic()
            run = model.spread(landscape, scenario)
            seconds.append(time.monotonic() - started)
            drawn.append(run)
            members.append(tuple(hectares(run, h, cell) for h in effect.hours_shown()))
        version = f"Pyretechnics {model.version}"
    if drawn:
        probability = burn_probability(drawn)
        effect = FireEffect(
            runs[0], runs[1], effect.changed, cell, scenario.hours, probability, tuple(members)
        )  # fmt: skip
    return FireResult(effect, version, tuple(seconds))
