"""Drawn scenarios: a function of kind and seed, valid for any seed, and each renders."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.config_io import load_yaml
from ltm_lab.cli.main import cli
from ltm_lab.simulator import scenario_draw
from ltm_lab.simulator.output_io import write_scenario
from ltm_lab.simulator.run import make_site, plan_shots, render_shots, site_at
from ltm_lab.simulator.scenario import GroundConfig, ImageSize, Scenario
from ltm_lab.simulator.scenario_draw import KINDS, RANGES, draw_scenario
from ltm_lab.simulator.terrain_synthesis import HeightField, SyntheticTerrain


def hills(config: GroundConfig, seed: int) -> SyntheticTerrain:
    """Ground that costs no time to make."""
    n = round(config.size / 20)
    geometry = GridGeometry(0.0, config.size, 20.0, n, n)
    x, y = np.meshgrid(*HeightField(np.empty((0, 0), np.float32), geometry).axes())
    field = HeightField((300 + 60 * np.sin(x / 170 + seed) * np.cos(y / 130)).astype(np.float32), geometry)
    return SyntheticTerrain(field, field, field.elevation)


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_draws_one_scenario(kind: str, tmp_path: Path) -> None:
    drawn = draw_scenario(kind, 31)
    assert drawn == draw_scenario(kind, 31)
    assert drawn.name == f"{kind}_31"
    write_scenario(tmp_path / "new", drawn)
    assert load_yaml(tmp_path / "new" / "scenario.yaml", Scenario) == drawn


@pytest.mark.parametrize("kind", KINDS)
def test_all_seeds_are_valid_and_differ(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The scenario's own checks hold: all cameras, masks and lakes are inside the site."""
    monkeypatch.setattr(scenario_draw, "make_terrain", hills)
    drawn = [draw_scenario(kind, seed) for seed in range(200)]
    assert len({s.model_copy(update={"name": "", "seed": 0}).model_dump_json() for s in drawn}) == 200
    column, fixed = KINDS[kind]
    for key, _, ranges in RANGES:
        group, name = key.split(".")
        if name in fixed.get(group, {}):
            continue
        (low, high), values = ranges[column], [getattr(getattr(s, group), name) for s in drawn]
        assert low <= min(values) <= max(values) <= high, key
        if low < high:
            assert max(values) - min(values) > 0.8 * (high - low), key


def test_only_known_kinds_are_drawn() -> None:
    with pytest.raises(ConfigError, match="towers"):
        draw_scenario("towers", 1)
    with pytest.raises(ConfigError, match="-1"):
        draw_scenario("tower", -1)


def test_a_kind_needs_a_seed_and_a_seed_a_kind(tmp_path: Path) -> None:
    run = partial(CliRunner().invoke, cli, catch_exceptions=False)
    with pytest.raises(LtmError, match="--seed"):
        run(["simulate", "tower", "--out", str(tmp_path)])
    with pytest.raises(LtmError, match="kind"):
        run(["simulate", "demo.yaml", "--seed", "3", "--out", str(tmp_path)])


def tiny(scenario: Scenario) -> Scenario:
    """A scenario of the same plan on a small site with few samples."""
    size = scenario.terrain.size
    terrain = scenario.terrain.model_copy(update={"surroundings": size + 600.0, "resolution": 8.0})
    near = scenario.vegetation.model_copy(update={"detail_radius": 60.0, "grass_radius": 0.0, "houses": 0})
    image = ImageSize(width=32, height=18)
    imaging = scenario.imaging.model_copy(update={"samples": 1})
    return scenario.model_copy(update={"terrain": terrain, "vegetation": near, "image": image, "imaging": imaging})


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "frames"), [("tower", 48), ("training", 63), ("felled", 3), ("change", 3)])
def test_drawn_scenarios_render(kind: str, frames: int) -> None:
    pytest.importorskip("mitsuba", reason="needs the extra `sim`: pip install 'ltm[sim]'")
    scenario = tiny(draw_scenario(kind, 5))
    site, date = make_site(scenario), scenario.dates[-1]
    shots = plan_shots(scenario, site_at(scenario, site, scenario.dates[0]), date)
    assert len(shots) == frames
    frame = next(render_shots(scenario, site_at(scenario, site, date), shots))
    assert frame.image.shape == (18, 32, 3)
    assert np.ptp(frame.image) > 40
