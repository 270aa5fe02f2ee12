from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.config_io import load_yaml
from ltm_lab.simulator import scenario_draw
from ltm_lab.simulator.output_io import write_scenario
from ltm_lab.simulator.scenario import GroundConfig, Scenario
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
