from pathlib import Path

import pytest

from ltm_core.storage.config_io import load_yaml
from ltm_lab.simulator.output_io import write_scenario
from ltm_lab.simulator.scenario import Scenario
from ltm_lab.simulator.scenario_draw import KINDS, draw_scenario


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_draws_one_scenario(kind: str, tmp_path: Path) -> None:
    drawn = draw_scenario(kind, 31)
    assert drawn == draw_scenario(kind, 31)
    assert drawn.name == f"{kind}_31"
    write_scenario(tmp_path / "new", drawn)
    assert load_yaml(tmp_path / "new" / "scenario.yaml", Scenario) == drawn
