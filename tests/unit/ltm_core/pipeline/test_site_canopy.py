from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from scenes.small_site import SmallSite, write_small_site

from ltm_core.base.types import Float32Array
from ltm_core.fuel.canopy import stand_heights
from ltm_core.fuel.codes import FuelClimate
from ltm_core.fuel.surface_change import LivingFuelMap
from ltm_core.fuel.votes import CellVisibility, CellVotes
from ltm_core.pipeline.site_fuel import site_canopy, site_evidence_map
from ltm_core.pipeline.site_surface import STORE_FILE, given_terrain, open_stored_surface
from ltm_core.storage.tile_store import TileStore
from ltm_core.surface.reference_surface import Reference
from ltm_core.surface.surface_map import SurfaceMap
from ltm_core.surface.tile_pool import TILE, schema_of
from ltm_core.vision.labels import LabelSet

LABELS = LabelSet.load()
WOOD = 183
CELL = (6, 4)


@pytest.fixture
def small(tmp_path: Path) -> SmallSite:
    (tmp_path / "site").mkdir()
    found = write_small_site(tmp_path / "site", recording=False)
    found.path.write_text(found.path.read_text() + yaml.safe_dump({"terrain": {}}))
    return SmallSite(found.folder)


def wooded(small: SmallSite) -> LivingFuelMap:
    """All cells have come to be trees; a camera has seen one of them, a third of whose pixels are open."""
    grid = small.site.fuel_geometry(small.dem)
    evidence = site_evidence_map(small.site, grid, LABELS)
    evidence.recall(np.full(grid.shape, WOOD, np.int32))
    counts = np.zeros((1, len(LABELS)), np.uint32)
    counts[0, LABELS.names.index("tree")], counts[0, LABELS.names.index("grass")] = 20, 10
    seen = CellVisibility(*(np.array([v], np.float32) for v in (0.5, 2.0, 1.0, 1.0, 0.1)))
    cell = (np.array([index], np.int32) for index in CELL)
    evidence.add(CellVotes(grid, *cell, counts, np.zeros(1, np.float32), 10**18, "north", None, seen))
    return evidence


def stands_of(small: SmallSite, state: Path, height: float | Float32Array, weight: float = 1000.0) -> None:
    """A terrain store of which one fuel cell's terrain cells, 3 x 3, are known to stand so high."""
    reference = Reference.of(small.dem, None)
    grid = small.site.fuel_geometry(small.dem)
    rows, cols = reference.geometry.cell_of(*grid.to_map(*(np.array([i + d for d in (-0.3, 0, 0.3)]) for i in CELL)))
    key = int(rows[1]) // TILE, int(cols[1]) // TILE
    with TileStore.open(state / STORE_FILE, schema_of(small.site.in_crs(reference.geometry))) as store:
        surface = SurfaceMap(reference, small.site.terrain, ("north", "south"), store)
        blank = {n: np.zeros((TILE, TILE, *f.shape), np.dtype(f.dtype)) for n, f in store.schema.fields.items()}
        at = np.ix_(np.unique(rows) % TILE, np.unique(cols) % TILE)
        known = {"dz": height, "base": height, "looks": 4.0, "weight": weight, "cameras": 3, "frames": 4,
                 "relative_variance": 0.01, "pose_variance": 0.0, "first": 1, "last": 10**6}  # fmt: skip
        for name, value in known.items():
            blank[name][at] = value
        store.commit({key: blank})
        del surface


def test_new_trees_have_the_cover_that_labels_show_and_the_height_that_depth_does(
    small: SmallSite, tmp_path: Path
) -> None:
    evidence, climate = wooded(small), FuelClimate.named("dry")
    stands_of(small, tmp_path, 8.0)
    terrain, grid = given_terrain(small.site), evidence.geometry
    args = small.site, grid, evidence.layers(), evidence.prior, climate, terrain
    nothing = site_canopy(*args)
    assert np.isnan(nothing.seen.cover).all()
    found = site_canopy(*args, evidence, tmp_path)
    assert found.note == ""
    assert np.argwhere(np.isfinite(found.seen.cover)).tolist() == [list(CELL)]
    assert 10 < found.seen.cover[CELL] < climate.canopy.cover
    assert np.argwhere(np.isfinite(found.seen.height)).tolist() == [list(CELL)]
    # Seen from the side, the higher crowns hide the lower.
    assert found.seen.height[CELL] == pytest.approx(0.8 * 8.0, abs=0.1)


def test_a_height_meets_what_the_map_said_by_their_standard_errors(small: SmallSite, tmp_path: Path) -> None:
    stands_of(small, tmp_path, 8.0, weight=0.04)
    surface, grid = open_stored_surface(tmp_path / STORE_FILE, small.site), small.site.fuel_geometry(small.dem)
    alone, both = (stand_heights(surface, grid, np.full(grid.shape, said)) for said in (np.nan, 15.0))
    surface.close()
    assert alone[CELL] + 0.5 < both[CELL] < 14.5


def test_a_terrain_of_another_grid_is_told_and_the_export_goes_on(small: SmallSite, tmp_path: Path) -> None:
    evidence = wooded(small)
    stands_of(small, tmp_path, 8.0)
    assert small.site.terrain is not None
    finer = small.site.model_copy(update={"terrain": small.site.terrain.model_copy(update={"resolution": 5.0})})
    found = site_canopy(
        finer, evidence.geometry, evidence.layers(), evidence.prior, FuelClimate.named("dry"),
        given_terrain(finer), evidence, tmp_path,
    )  # fmt: skip
    assert "heights of trees are not from the terrain map" in found.note
    assert np.isnan(found.seen.height).all()
    assert np.isfinite(found.seen.cover[CELL])
