"""What a fire is given, and what is told of what cannot be."""

from pathlib import Path

import numpy as np
import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.fire.effect import FireScenario, Moisture, Wind, ignition_cell
from ltm_core.fire.pyretechnics import VARIABLE, FireModelError, spread
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.grid import GridGeometry

GRID = GridGeometry(345_975.0, 3_783_195.0, 30.0, 9, 7, "EPSG:32611")


def landscape() -> Landscape:
    bands = np.zeros((8, *GRID.shape), np.int16)
    bands[3] = 102
    bands[3, :, 3] = 98
    bands[3, 0] = NODATA
    bands[3, 6, 8] = 91
    return Landscape(bands, GRID)


def at(row: int, col: int) -> str:
    x, y = GRID.to_map(row, col)
    return f"{float(x)},{float(y)}"


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("D1L1", (3, 4, 5, 30, 60)),
        ("d2l3", (6, 7, 8, 90, 120)),
        ("D4L4", (12, 13, 14, 120, 150)),
        ("5,6.5,8,70,110", (5, 6.5, 8, 70, 110)),
    ],
)
def test_moistures(text: str, values: tuple[float, ...]) -> None:
    m = Moisture.parse(text)
    assert (m.dead_1h, m.dead_10h, m.dead_100h, m.live_herbaceous, m.live_woody) == values


@pytest.mark.parametrize("text", [None, "", "D5L1", "6,7,8", "6,7,8,60,much", "6,7,8,60,-3", "6,7,8,60,nan"])
def test_no_moisture_is_told_with_what_there_is(text: str | None) -> None:
    with pytest.raises(ConfigError, match=r"D2L2 .*6,7,8,60,90"):
        Moisture.parse(text)


def test_wind() -> None:
    assert Wind.parse("8,45") == Wind(8.0, 45.0)
    assert Wind.parse("8,360").direction == 0
    for text in ("8", "8,north", "-1,4", "8,400", "nan,5", "1,2,3"):
        with pytest.raises(ConfigError, match="--wind"):
            Wind.parse(text)


@pytest.mark.parametrize("hours", [0.0, -1.0, 100.0, float("nan")])
def test_hours(hours: float) -> None:
    with pytest.raises(ConfigError, match="72 hours"):
        FireScenario(1, 1, Wind(3, 0), Moisture.parse("D2L2"), hours)


def test_a_place_in_the_landscapes_crs_or_in_degrees() -> None:
    assert ignition_cell(at(4, 6), None, landscape()) == (4, 6)
    from pyproj import Transformer

    x, y = (float(v) for v in GRID.to_map(4, 6))
    lon, lat = Transformer.from_crs("EPSG:32611", "EPSG:4326", always_xy=True).transform(x, y)
    assert ignition_cell(f"{lon},{lat}", "EPSG:4326", landscape()) == (4, 6)
    with pytest.raises(ConfigError, match=r"outside the landscape.*looks like degrees: add --ignition-crs EPSG:4326"):
        ignition_cell(f"{lon},{lat}", None, landscape())
    with pytest.raises(ConfigError, match="EPSG:0"):
        ignition_cell(f"{lon},{lat}", "EPSG:0", landscape())


def test_a_place_where_nothing_can_start() -> None:
    nearest = at(2, 2).replace(".0", "")
    with pytest.raises(ConfigError, match=rf"there is water there; the nearest cell that burns is at {nearest}"):
        ignition_cell(at(2, 3), None, landscape())
    with pytest.raises(ConfigError, match="nothing is known there; the nearest"):
        ignition_cell(at(0, 6), None, landscape())
    with pytest.raises(ConfigError, match=r"nothing burns \(code 91\) there"):
        ignition_cell(at(6, 8), None, landscape())
    with pytest.raises(ConfigError, match="is outside the landscape"):
        ignition_cell("346000,3700000", None, landscape())
    for text in ("here", "1", "1,2,3", "nan,nan"):
        with pytest.raises(ConfigError, match="--ignition"):
            ignition_cell(text, None, landscape())


def test_a_model_that_fails_is_reported_with_its_last_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = tmp_path / "python"
    script.write_text("#!/bin/sh\necho loading >&2\necho out of memory >&2\nexit 1\n")
    script.chmod(0o755)
    monkeypatch.setenv(VARIABLE, str(script))
    scenario = FireScenario(1, 1, Wind(10.0, 45.0), Moisture.parse("D1L1"), 1.0)
    with pytest.raises(FireModelError, match="out of memory"):
        spread(landscape(), scenario)
