"""Pyretechnics behind our adapter: rates of spread against BehavePlus' code, on flat uniform fuel and across a grid.

Its pins (NumPy 1.26) exclude ours, so it runs in an interpreter of its own: that of `make fire`, or LTM_PYRETECHNICS.
"""

import json
import math
import subprocess
from pathlib import Path

import numpy as np
import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.fire import pyretechnics
from ltm_core.fire.effect import FireScenario, Moisture, Wind
from ltm_core.fire.pyretechnics import interpreter, spread
from ltm_core.fuel.codes import fuel_models
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.geometry.grid import GridGeometry


def available() -> bool:
    try:
        return interpreter().is_file()
    except ConfigError:
        return False


pytestmark = pytest.mark.skipif(not available(), reason="no Python that has pyretechnics: `make fire` makes one")
REFERENCE = json.loads(Path(__file__).with_name("behave_rates.json").read_text(encoding="utf-8"))
CHAINS_AN_HOUR = 20.1168 / 60
DEPTHS = REFERENCE["fuel_bed_feet"]  # of the fuel models by code, by which the wind at the flames is reduced
D2L2 = Moisture.parse("D2L2")


HEAD_RATES = """
import json, runpy, sys
import numpy as np
from pyretechnics.burn_cells import burn_cell_as_head_fire
worker = runpy.run_path(sys.argv[1])
for line in sys.stdin:
    asked = json.loads(line)
    bands = np.zeros((7, 1, 1), np.int16)
    bands[2] = asked["code"]
    found = burn_cell_as_head_fire(worker["cubes"](bands, worker["weather_of"](asked), (1, 1, 1)), (0, 0, 0))
    print(float(found["spread_rate"]), float(found["flame_length"]))
"""


def head_rates(asked: list[tuple[int, Wind, Moisture]]) -> list[tuple[float, float]]:
    """m/min, and flame length in metres, of head fires on flat ground without trees, as the worker describes them."""
    lines = [
        json.dumps({"code": c, "wind_speed": w.speed, "wind_from": w.direction, "moisture": list(vars(m).values())})
        for c, w, m in asked
    ]
    worker = Path(pyretechnics.__file__).with_name("pyretechnics_worker.py")
    command = [str(interpreter()), "-I", "-c", HEAD_RATES, str(worker)]
    said = subprocess.run(command, input="\n".join(lines), capture_output=True, text=True, check=True).stdout
    return [(float(a), float(b)) for a, b in (line.split() for line in said.splitlines())]


def at_10_m(midflame_mph: float, depth_ft: float) -> float:
    """m/s at 10 m that are so much at the height of the flames, unsheltered (Andrews 2012, equation 6)."""
    factor = 1.83 / math.log((20 + 0.36 * depth_ft) / (0.13 * depth_ft))
    return midflame_mph * 0.44704 / factor * 1.15


def test_rates_and_flames_of_every_fuel_model_within_5_percent() -> None:
    models = fuel_models()
    every = {**models.fbfm13, **models.fbfm40}
    rows = REFERENCE["rows"]
    assert {code for _, _, code, _, _ in rows} == set(every)
    moistures = {k: Moisture(*(float(v) for v in values)) for k, values in REFERENCE["moisture_percent"].items()}
    asked = [(code, Wind(at_10_m(wind, DEPTHS[str(code)]), 0.0), moistures[k]) for k, wind, code, _, _ in rows]
    for (scenario, wind, code, chains, feet), (rate, flame) in zip(rows, head_rates(asked), strict=True):
        assert rate / CHAINS_AN_HOUR == pytest.approx(chains, rel=0.05), (scenario, wind, code)
        assert flame / 0.3048 == pytest.approx(feet, rel=0.05), (scenario, wind, code)


@pytest.mark.parametrize("code", [1, 3, 4, 9, 10, 13])
def test_rates_that_anderson_published(code: int) -> None:
    """Anderson (1982): chains/h and feet at 5 mi/h, dead fuel of 8 %, live of 100 %. Of his other models BehavePlus
    itself differs from his nomograms by 7 to 30 %.
    """
    chains, feet = {1: (78, 4), 3: (104, 12), 4: (75, 19), 9: (7.5, 2.6), 10: (7.9, 4.8), 13: (13.5, 10.5)}[code]
    wind = Wind(at_10_m(5.0, DEPTHS[str(code)]), 0.0)
    ((rate, flame),) = head_rates([(code, wind, Moisture(8, 8, 8, 100, 100))])
    assert rate / CHAINS_AN_HOUR == pytest.approx(chains, rel=0.05)
    assert flame / 0.3048 == pytest.approx(feet, rel=0.08)


def flat(code: int, height: int = 81, width: int = 121) -> Landscape:
    grid = GridGeometry(500_000.0, 4_000_000.0, 30.0, width, height, "EPSG:32611")
    bands = np.zeros((8, *grid.shape), np.int16)
    bands[0], bands[2], bands[3] = 500, -1, code
    return Landscape(bands, grid)


@pytest.mark.parametrize(("direction", "step"), [(270.0, (0, 1)), (180.0, (-1, 0)), (0.0, (1, 0)), (90.0, (0, -1))])
def test_a_fire_runs_downwind_at_the_head_rate(direction: float, step: tuple[int, int]) -> None:
    """North is up: a wind from the south carries it to smaller rows."""
    wind = Wind(5.0, direction)
    ((rate, _),) = head_rates([(102, wind, D2L2)])
    landscape = flat(102, 121, 123)
    found = spread(landscape, FireScenario(60, 61, wind, D2L2, 2.5))[0]
    cells = [(60 + k * step[0], 61 + k * step[1]) for k in range(8, 40)]
    arrival = np.array([found.arrival[cell] for cell in cells])
    reached = np.isfinite(arrival)
    assert reached.sum() > 10
    speed = np.polyfit(arrival[reached] * 60, np.flatnonzero(reached) * 30.0, 1)[0]
    assert speed == pytest.approx(rate, rel=0.05)
    against = (60 - 15 * step[0], 61 - 15 * step[1])
    assert not np.isfinite(found.arrival[against])


def test_a_fire_runs_uphill() -> None:
    landscape = flat(102)
    bands = landscape.bands.copy()
    bands[1], bands[2] = 25, 180  # the ground falls to the south
    found = spread(Landscape(bands, landscape.geometry), FireScenario(40, 60, Wind(0.0, 0.0), D2L2, 2.0))[0]
    rows = np.nonzero(found.burned)[0]
    assert 40 - rows.min() > 2 * (rows.max() - 40)


def test_nothing_burns_on_water_and_what_is_not_known() -> None:
    landscape = flat(102)
    bands = landscape.bands.copy()
    bands[3, :, 70:73] = 98
    bands[:, 20, :] = -9999
    bands[3, 50, :] = 37  # an analyst's own model, which Pyretechnics does not have
    found = spread(Landscape(bands, landscape.geometry), FireScenario(40, 60, Wind(6.0, 200.0), D2L2, 4.0))[0]
    assert not found.burned[:, 70:].any()
    assert not found.burned[:21].any()
    assert not found.burned[50:].any()
    assert found.arrival[40, 60] == 0.0
    assert found.burned.sum() > 500
    assert (found.flame[found.burned] >= 0).all()


def test_arrival_differs_where_and_only_where_the_changed_cells_can_matter() -> None:
    before = flat(102)
    bands = before.bands.copy()
    bands[3, 36:45, 80:90] = 99
    after = Landscape(bands, before.geometry)
    scenario = FireScenario(40, 60, Wind(5.0, 270.0), D2L2, 4.0)
    was, now = spread(before, scenario)[0], spread(after, scenario)[0]
    reached = float(np.nanmin(was.arrival[36:45, 80:90]))
    sooner = was.burned & (was.arrival < reached)
    assert sooner.sum() > 100
    np.testing.assert_allclose(now.arrival[sooner], was.arrival[sooner], atol=2 / 60)
    behind = (slice(39, 42), slice(91, 100))
    assert (np.nan_to_num(now.arrival[behind], nan=99.0) > was.arrival[behind] + 0.05).all()
    assert not now.burned[36:45, 80:90].any()
