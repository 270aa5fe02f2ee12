"""What an update changes of a fire, of small fires worked out by hand; its GeoTIFF and its pictures."""

from pathlib import Path

import numpy as np
import pytest
import rasterio

from ltm_core.fire.effect import BANDS, FireEffect, FireRun, FireScenario, Moisture, Wind, changed_fuel, write_fire
from ltm_core.fuel.export.landscape import Landscape
from ltm_core.geometry.grid import GridGeometry
from ltm_core.pictures.fire_maps import DIFFERENCE, arrival_overlay, arrival_scale, difference_classes, fire_sheet

GRID = GridGeometry(345_975.0, 3_783_195.0, 100.0, 6, 4, "EPSG:32611")  # a hectare a cell


def run(*arrival: list[float]) -> FireRun:
    hours = np.array(arrival, np.float32)
    burned = np.isfinite(hours)
    return FireRun(hours, np.where(burned, 2.0, 0.0).astype(np.float32))


N = float("nan")
BEFORE = run([N] * 6, [N, 0.0, 0.5, 1.0, 2.0, N], [N, 0.5, 0.7, 1.5, N, N], [N] * 6)
AFTER = run([N] * 6, [N, 0.0, 0.5, 2.5, N, N], [N, 0.5, 0.7, 1.5, 2.9, N], [N] * 6)


def effect() -> FireEffect:
    changed = np.zeros(GRID.shape, bool)
    changed[1, 3:5] = changed[0, 0] = True
    return FireEffect(BEFORE, AFTER, changed, 100.0, 3.0)


def test_hectares_by_the_hour() -> None:
    rows = effect().areas()
    assert [(r.hours, r.before, r.after) for r in rows] == [(1.0, 5, 4), (3.0, 7, 7)]


def test_where_it_comes_later_earlier_or_only_once() -> None:
    values, known = difference_classes(effect())
    names = [DIFFERENCE.names[int(v)] for v in values[known]]
    assert known.sum() == 8
    assert names == [
        "the same to 5 min", "the same to 5 min", "later by 1 h and more", "burns only with the previous map",
        "the same to 5 min", "the same to 5 min", "the same to 5 min", "burns only with the updated map",
    ]  # fmt: skip
    turned = FireEffect(AFTER, BEFORE, effect().changed, 100.0, 3.0)
    assert DIFFERENCE.names[int(difference_classes(turned)[0][1, 3])] == "earlier by 1 h and more"
    # The other fire may come a moment after the end.
    late = run([N] * 6, [N, 0.0, 0.5, 1.0, 2.0, 2.95], [N, 0.5, 0.7, 1.5, N, 2.9], [N] * 6)
    for pair in ((BEFORE, late), (late, BEFORE)):
        found = difference_classes(FireEffect(*pair, effect().changed, 100.0, 3.0))[0]
        assert DIFFERENCE.names[int(found[1, 5])] == "the same to 5 min"
        assert DIFFERENCE.names[int(found[2, 5])].startswith("burns only")
    assert effect().first_contact() == 1.0
    felled = FireEffect(BEFORE, AFTER, ~AFTER.burned, 100.0, 3.0)
    assert felled.first_contact() == 2.0
    untouched = np.zeros(GRID.shape, bool)
    untouched[0, 0] = True
    assert FireEffect(BEFORE, AFTER, untouched, 100.0, 3.0).first_contact() is None
    assert effect().after.reaches_edge() is None
    edge = run([N] * 6, [0.0, 0.5, N, N, N, N], [N] * 6, [1.0, N, N, N, N, N])
    assert edge.reaches_edge() == 0.0


def landscape(fuel: int = 102) -> Landscape:
    bands = np.zeros((8, *GRID.shape), np.int16)
    bands[0] = np.arange(24).reshape(GRID.shape) * 7 + 300
    bands[3] = fuel
    return Landscape(bands, GRID)


def test_changed_fuel_is_fuel_or_canopy_not_terrain() -> None:
    other = landscape().bands.copy()
    other[0, 0, 0] += 5
    other[3, 1, 2] = 145
    other[6, 2, 3] = 4
    assert np.argwhere(changed_fuel(landscape(), Landscape(other, GRID))).tolist() == [[1, 2], [2, 3]]


def test_a_geotiff_and_pictures(tmp_path: Path) -> None:
    made = effect()
    write_fire(tmp_path / "fire.tif", made, GRID, {"wind": "8 m/s"})
    with rasterio.open(tmp_path / "fire.tif") as source:
        assert source.descriptions == tuple(BANDS)
        assert source.units == tuple(BANDS.values())[: source.count]
        assert source.tags()["wind"] == "8 m/s"
        bands = source.read()
    np.testing.assert_array_equal(bands[0], BEFORE.arrival)
    np.testing.assert_allclose(bands[2][1, 3], 1.5)
    assert np.isnan(bands[2][1, 4])
    sheet = fire_sheet(made, landscape(), FireScenario(1, 1, Wind(8.0, 45.0), Moisture.parse("D2L2"), 6.0))
    assert sheet.shape[0] < 1.5 * sheet.shape[1]
    picture, legend = arrival_overlay(made, landscape())
    assert picture.shape == (16, 24, 3)
    assert legend.shape[1] == 520


@pytest.mark.parametrize("hours", [1.0, 6.0, 24.0])
def test_times_are_named_from_ignition_to_the_end(hours: float) -> None:
    scale = arrival_scale(hours)
    assert len(scale.names) == 8
    assert scale.names[0].startswith("0 to ")
    assert scale.names[-1].endswith(f" to {hours:g} h")
