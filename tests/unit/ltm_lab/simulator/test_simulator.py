import numpy as np
import pytest

from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.config_io import load_yaml
from ltm_lab.resources import lab_config
from ltm_lab.simulator.camera_setup import ViewsConfig
from ltm_lab.simulator.imaging import add_haze
from ltm_lab.simulator.landcover import GRASS, SHRUB, TREE, LandCover, Stand
from ltm_lab.simulator.rasters import fuel_truth
from ltm_lab.simulator.scenario import AtmosphereConfig, GroundConfig, Scenario
from ltm_lab.simulator.terrain_synthesis import SyntheticTerrain, make_terrain
from ltm_lab.simulator.viewpoints import draw_viewpoints

SMALL = GroundConfig(size=512.0, surroundings=1024.0, relief=180.0, base_elevation=300.0)


@pytest.fixture(scope="module")
def terrain() -> SyntheticTerrain:
    return make_terrain(SMALL, seed=5)


def test_committed_scenarios_load() -> None:
    files = sorted(lab_config("scenarios/demo.yaml").parent.glob("*.yaml"))
    assert files
    names = [load_yaml(f, Scenario).name for f in files]
    assert names == [f.stem for f in files]


def test_terrain_is_a_function_of_its_seed(terrain: SyntheticTerrain) -> None:
    again = make_terrain(SMALL, seed=5)
    np.testing.assert_array_equal(terrain.site.elevation, again.site.elevation)
    other = make_terrain(SMALL, seed=6)
    assert np.abs(other.site.elevation - terrain.site.elevation).mean() > 5.0


def test_fuel_truth_is_the_majority_in_snapped_cells() -> None:
    geometry = GridGeometry(0.0, 60.0, 5.0, 18, 12)
    classes = np.full((12, 18), SHRUB, np.uint8)
    classes[:6, :6] = TREE  # map x 0..30, y 30..60
    classes[:3, 6:12] = GRASS  # half of x 30..60, y 30..60: a tie of grass and shrub
    zeros = np.zeros(classes.shape, np.float32)
    cover = LandCover(classes, np.zeros(classes.shape, bool), zeros, zeros, geometry, Stand.undisturbed(classes.shape))
    cells = GridGeometry.snapped((1015.0, 2025.0, 1085.0, 2075.0), 30.0, 15.0, "EPSG:32611")
    truth = fuel_truth(cover, cells, (1005.0, 2025.0))
    assert cells.shape == (2, 3)
    assert (cells.x_min, cells.y_max) == (1005.0, 2085.0)
    assert truth.tolist() == [[TREE, GRASS, SHRUB], [SHRUB, SHRUB, SHRUB]]
    larger = fuel_truth(cover, GridGeometry(0.0, 90.0, 30.0, 4, 3), (0.0, 0.0))
    assert larger.tolist() == [[255, 255, 255, 255], [TREE, GRASS, SHRUB, 255], [SHRUB, SHRUB, SHRUB, 255]]


def test_viewpoints_are_seeded_and_above_ground(terrain: SyntheticTerrain) -> None:
    wish = ViewsConfig(positions=3, views=4, mast=(5.0, 9.0), pitch_deg=(-12.0, -2.0))
    places = draw_viewpoints(terrain.site, wish, seed=8)
    assert [len(p) for p in places] == [4, 4, 4]
    for v in (v for p in places for v in p):
        assert 5.0 <= v.eye[2] - terrain.site.at(v.eye[0], v.eye[1]) <= 9.0
        assert -12.0 <= v.pitch_deg <= -2.0
    again = draw_viewpoints(terrain.site, wish, seed=8)
    assert [v.azimuth_deg for p in places for v in p] == [v.azimuth_deg for p in again for v in p]


def test_haze_follows_beer_and_lambert() -> None:
    radiance = np.full((2, 3, 3), 0.2, np.float32)
    lengths = np.array([[0.0, 5000.0, 1e9], [5000.0, 0.0, 1e9]], np.float32)
    air = np.array([0.5, 0.6, 0.7], np.float32)
    out = add_haze(radiance, [lengths], air, AtmosphereConfig(visibility=10_000.0, blue=0.4))
    half = np.exp(-0.5 * np.array([0.8, 1.0, 1.2]))
    np.testing.assert_allclose(out[0, 0], 0.2, rtol=1e-6)
    np.testing.assert_allclose(out[0, 1], 0.2 * half + air * (1 - half), rtol=1e-5)
    np.testing.assert_allclose(out[1, 2], air, rtol=1e-5)
