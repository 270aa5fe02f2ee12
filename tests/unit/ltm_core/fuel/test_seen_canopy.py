import numpy as np
import pytest

from ltm_core.base.types import Float32Array, Int16Array
from ltm_core.fuel.canopy import crown_fuel, seen_canopy, with_seen_canopy
from ltm_core.fuel.codes import ForestType
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.surface.confirmed_surface import ConfirmedSurface
from ltm_core.surface.surface_versions_io import ConfirmedTerrain

FINE = GridGeometry(0.0, 120.0, 2.0, 90, 60)
FUEL = GridGeometry(0.0, 120.0, 30.0, 6, 4)


def terrain(changed_cols: int) -> ConfirmedTerrain:
    """Trees of 20 m all over; of the first `changed_cols` columns of fuel cell (1, 2) all but every third row is
    gone.
    """
    rows, cols = np.indices(FINE.shape)
    ground = Dem((0.2 * rows + 0.1 * cols).astype(np.float32), FINE)
    top = Dem(ground.elevation + np.float32(20.0), FINE)
    gone_rows, gone_cols = np.meshgrid(
        [row for row in range(15, 30) if row % 3], np.arange(30, 30 + changed_cols), indexing="ij"
    )
    cells = gone_rows.ravel().astype(np.int32), gone_cols.ravel().astype(np.int32)
    nan = np.full(len(cells[0]), np.nan, np.float32)
    surface = ConfirmedSurface(FINE, *cells, ground.elevation[cells], nan)
    return ConfirmedTerrain(None, ground, surface.surface_over(top), surface)


def test_cover_and_height_are_those_of_what_is_left() -> None:
    seen = seen_canopy(terrain(15), FUEL)
    assert seen is not None
    assert np.argwhere(np.isfinite(seen[0])).tolist() == [[1, 2]]
    assert seen[0, 1, 2] == pytest.approx(100 / 3, abs=0.5)
    assert seen[1, 1, 2] == pytest.approx(20.0, abs=0.5)


def canopy(cover: list[float], height: list[float]) -> Float32Array:
    return np.array([[cover], [height]], np.float32)


def bands_of(cells: int) -> Int16Array:
    """Cover 60 %, height 15 m, base 3 m, 0.12 kg/m3."""
    return np.repeat(np.array([60, 150, 30, 12], np.int16)[:, None, None], cells, axis=2)


def test_base_and_density_follow_what_was_measured() -> None:
    nan = np.nan
    seen = canopy([20.0, nan, 0.0, 30.0, 20.0], [10.0, nan, 0.0, 25.0, 10.0])
    bands = bands_of(5)
    bands[:, 0, 3] = 0, 0, 0, 0
    codes = np.array([[165, 165, 165, 165, 186]], np.int16)
    found = with_seen_canopy(bands, seen, codes)
    was, now = (crown_fuel(np.array(c), np.array(h), ForestType.MIXED_CONIFER) for c, h in ((60.0, 15.0), (20.0, 10.0)))
    assert found[:2, 0, 0].tolist() == [20, 100]
    assert found[2, 0, 0] == round(30 * float(now[0] / was[0]))
    assert found[3, 0, 0] == round(12 * float(now[1] / was[1]))
    assert found[:, 0, 1].tolist() == [60, 150, 30, 12], "nothing was measured: the prior's"
    assert found[:, 0, 2].tolist() == [0, 0, 0, 0], "no canopy is left"
    assert found[:, 0, 3].tolist() == [0, 0, 0, 0], "no trees: the code decides"
    assert found[:, 0, 4].tolist() == [20, 100, 30, 12], "no allometry of broadleaved stands"
    bands[:] = NODATA
    assert (with_seen_canopy(bands, seen, codes) == NODATA).all()


@pytest.mark.parametrize(("said", "most"), [(11, 45), (60, 60)])
def test_a_stand_that_is_low_now_is_no_denser_than_stands_are(said: int, most: int) -> None:
    """By the regressions alone one of 15 m that is 3 m high now would have 8 kg/m3."""
    bands = np.array([55, 150, 15, said], np.int16).reshape(4, 1, 1)
    cover, height = (np.full((1, 1), value, np.float32) for value in (95, 3))
    found = with_seen_canopy(bands, np.stack([cover, height]), np.full((1, 1), 183, np.int16))
    assert found[:2].ravel().tolist() == [95, 30]
    assert found[3, 0, 0] == most


def test_a_stand_by_hand() -> None:
    """55 % and 14 m: crowns of 2.1 m, 0.7985 / 13.854 m2 = 576.4 stems/ha of 20 cm, 18.107 m2/ha."""
    base, density = crown_fuel(np.array([55.0]), np.array([14.0]), ForestType.MIXED_CONIFER)
    assert base[0] == pytest.approx(-1.463 + 0.578 * 14 + 0.026 * 18.107, abs=1e-3)
    assert density[0] == pytest.approx(np.exp(-8.445) * 18.107**0.319 * 576.4**0.859, rel=1e-3)


@pytest.mark.parametrize("forest", ForestType)
def test_closer_stands_are_denser_and_taller_ones_have_higher_crowns(forest: ForestType) -> None:
    cover, height = np.meshgrid([5.0, 30.0, 70.0, 100.0], [1.0, 2.0, 8.0, 20.0, 60.0])
    base, density = crown_fuel(cover, height, forest)
    assert (np.diff(density[:, :3], axis=1) > 0).all()
    assert (np.diff(base, axis=0) > 0).all()
    assert ((base > 0) & (base <= height) & np.isfinite(density)).all()
