"""Canopy from the confirmed surface: worked out by hand, only where change was confirmed, and what follows from it."""

from __future__ import annotations

import numpy as np
import pytest

from ltm_core.confirmed_terrain import ConfirmedTerrain
from ltm_core.dem import Dem
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.seen_canopy import SeenCanopy, seen_canopy, with_seen_canopy
from ltm_core.grid import GridGeometry
from ltm_core.raster.confirmed_surface import ConfirmedSurface

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
    assert np.argwhere(np.isfinite(seen.cover)).tolist() == [[1, 2]]
    assert seen.cover[1, 2] == pytest.approx(100 / 3, abs=0.5)
    assert seen.height[1, 2] == pytest.approx(20.0, abs=0.5)
    assert 0 < seen.cover_sigma[1, 2] < 15
    assert 0 <= seen.height_sigma[1, 2] < 2


def test_a_cell_of_which_little_has_changed_keeps_its_prior() -> None:
    seen = seen_canopy(terrain(4), FUEL)
    assert seen is not None
    assert np.isnan(seen.cover).all()


def test_nothing_is_measured_without_trees_on_record_or_without_a_version() -> None:
    whole = terrain(15)
    assert seen_canopy(ConfirmedTerrain(None, whole.ground, whole.top), FUEL) is None
    assert seen_canopy(ConfirmedTerrain(None, whole.ground, whole.top, whole.surface, False), FUEL) is None


def test_base_follows_the_height_and_density_the_cover() -> None:
    shape = (1, 4)
    cover, height = np.array([[20.0, np.nan, 0.0, 30.0]]), np.array([[10.0, np.nan, 0.0, 25.0]])
    seen = SeenCanopy(*(a.astype(np.float32) for a in (cover, height, 0 * cover, 0 * height)))
    bands = np.empty((4, *shape), np.int16)
    for band, value in zip(bands, (60, 150, 30, 12), strict=True):
        band[:] = value
    bands[:, 0, 3] = 0, 0, 0, 0
    found = with_seen_canopy(bands, seen)
    assert found[:, 0, 0].tolist() == [20, 100, 20, 4]
    assert found[:, 0, 1].tolist() == [60, 150, 30, 12], "nothing was confirmed: the prior's"
    assert found[:, 0, 2].tolist() == [0, 0, 0, 0], "no canopy is left"
    assert found[:, 0, 3].tolist() == [0, 0, 0, 0], "no trees: the code decides"
    bands[:] = NODATA
    assert (with_seen_canopy(bands, seen) == NODATA).all()
