from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_lab.simulator.landcover import GRASS, TREE
from ltm_lab.simulator.real_site import Rendered, scenario_of, simulated_site, views_of

CRS = "EPSG:32611"
X, Y = 346_000.0, 3_783_000.0


@pytest.fixture
def site(tmp_path: Path) -> Site:
    """A plane that rises to the east, grass in the west and conifers in the east; the fuel map is 3 km wide."""
    grid = GridGeometry(X - 2500, Y + 2000, 10, 500, 400, CRS)
    row, col = np.mgrid[:400, :500]
    x, _ = grid.to_map(row, col)
    write_geotiff(tmp_path / "dem.tif", (600 + 0.1 * (x - X)).astype(np.float32), grid)
    fuel = GridGeometry.snapped((X - 1500, Y - 1500, X + 1500, Y + 1500), 30.0, 15.0, CRS)
    cells, _ = fuel.to_map(*np.mgrid[: fuel.height, : fuel.width])
    write_geotiff(tmp_path / "fuel.tif", np.where(cells < X, 102, 185).astype(np.int16), fuel, nodata=-9999)
    (tmp_path / "site.yaml").write_text(
        f"name: hill\ncrs: {CRS}\norigin: [{X}, {Y}]\ndem: {{path: dem.tif}}\nfuel: {{prior: fuel.tif}}\n"
        "cameras:\n  north:\n    calibration: {width: 1920, height: 1080, hfov_deg: 56}\n"
        f"    pose: {{x: {X + 100}, y: {Y - 50}, height_above_ground: 20, azimuth_deg: 165}}\n"
        "  north_east: {}\n"
    )
    return load_site(tmp_path / "site.yaml")


def test_ground_and_vegetation_are_the_sites(site: Site) -> None:
    dem = site.open_dem()
    (view,) = views_of(site, dem)
    made = simulated_site(site, dem, view.pose.position)
    x, y = np.array([-900.0, 150.0, 1200.0]), np.array([-300.0, 20.0, 700.0])
    np.testing.assert_allclose(made.terrain.site.at(x, y), 600 + 0.1 * x, atol=0.01)
    np.testing.assert_allclose(made.terrain.surroundings.at(x, y), 600 + 0.1 * x, atol=0.01)
    np.testing.assert_array_equal(made.cover.at(x, y), [GRASS, TREE, TREE])
    assert made.terrain.far is not None
    assert made.terrain.far.geometry.width * made.terrain.far.geometry.resolution >= 79_000
    assert made.terrain.far.at(30_000.0, 0.0) == pytest.approx(350.5, abs=10)  # beyond the DEM: its lowest height


def test_a_frame_has_the_pose_of_its_camera(site: Site) -> None:
    dem = site.open_dem()
    (view,) = views_of(site, dem)
    shot = Rendered.of(view.name, view, dem).shot
    assert shot.mast == pytest.approx(20, abs=1e-3)
    assert (shot.camera.width, shot.camera.height) == (960, 540)
    assert shot.camera.width / shot.camera.fx == pytest.approx(view.camera.width / view.camera.fx, rel=1e-6)
    scenario = scenario_of(site, 4)
    assert (scenario.crs, scenario.origin, scenario.imaging.samples) == (CRS, (X, Y), 4)


def test_a_photo_is_paired_without_the_distortion_of_its_lens(site: Site) -> None:
    dem = site.open_dem()
    (view,) = views_of(site, dem)
    bent = replace(view, camera=replace(view.camera, distortion=(-0.2, 0.05, 0.0, 0.0, 0.0)))
    rendered = Rendered.of(view.name, bent, dem)
    assert not any(rendered.shot.camera.distortion)
    x, y = 0.4, -0.2  # a direction, by its tangents
    r2 = x * x + y * y
    radial = 1 - 0.2 * r2 + 0.05 * r2 * r2
    camera = view.camera
    u, v = camera.cx + camera.fx * x * radial, camera.cy + camera.fy * y * radial
    photo = np.zeros((1080, 1920, 3), np.uint8)
    photo[round(v) - 2 : round(v) + 3, round(u) - 2 : round(u) + 3] = 255
    rows, cols = np.nonzero(np.asarray(rendered.like(photo))[..., 0] > 100)
    small = rendered.shot.camera
    assert cols.mean() == pytest.approx(small.cx + small.fx * x, abs=0.6)
    assert rows.mean() == pytest.approx(small.cy + small.fy * y, abs=0.6)
