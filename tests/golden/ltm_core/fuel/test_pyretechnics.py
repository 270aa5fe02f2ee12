"""A fire on our landscape, by Pyretechnics.

Its pins (NumPy 1.26) exclude ours, so it runs in an interpreter of its own: LTM_PYRETECHNICS names one that has it. The
adapter has its own tests, in `tests/golden/ltm_core/fire`.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from ltm_core.fuel.export.landscape import Landscape, terrain_bands
from ltm_core.fuel.export.landscape_io import write_landscape
from ltm_core.geometry.grid import GridGeometry

INTERPRETER = os.environ.get("LTM_PYRETECHNICS", "")


@pytest.mark.skipif(not INTERPRETER, reason="LTM_PYRETECHNICS names no Python that has pyretechnics")
def test_a_fire_knows_our_fuels(tmp_path: Path) -> None:
    grid = GridGeometry(500_000.0, 4_000_000.0, 30.0, 61, 41, "EPSG:32611")
    rows, _ = np.indices(grid.shape)
    fuel = np.where(
        rows < 14, 102, np.where(rows < 28, 145, 165)
    )  # grass, shrubs, timber over shrubs from north to south
    fuel[:, 45:48] = 91
    fuel[20, 25:30] = 98
    trees = fuel == 165
    canopy = [np.where(trees, value, 0) for value in (55, 150, 15, 11)]
    height = 0.02 * 30.0 * np.add.outer(np.arange(43.0), np.zeros(63)) + 500
    bands = np.concatenate([terrain_bands(height, 30.0), np.array([fuel, *canopy], np.int16)])
    path = write_landscape(tmp_path / "landscape.tif", Landscape(bands.astype(np.int16), grid))
    script = Path(__file__).with_name("pyretechnics_spread.py")
    burned = {}
    for start in (7, 21, 35):
        out = subprocess.run(
            [INTERPRETER, str(script), str(path), str(start), "20"], capture_output=True, text=True, check=True
        )
        for code, values in json.loads(out.stdout).items():
            best = burned.setdefault(int(code), values)
            best["burned"] = max(best["burned"], values["burned"])
            best["rate"] = max(best["rate"], values["rate"])
    assert burned[91]["burned"] == burned[98]["burned"] == 0
    assert all(burned[code]["burned"] > 2 for code in (102, 145, 165)), burned
    rates = [burned[code]["rate"] for code in (165, 145, 102)]
    assert max(rates) > 3 * min(rates)
    assert len({round(rate, 3) for rate in rates}) == 3
