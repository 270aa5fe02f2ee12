from dataclasses import replace

import numpy as np
import pytest
from scenes.small_scenario import small_scenario
from scipy import ndimage

pytest.importorskip("mitsuba", reason="needs the extra `sim`: pip install './ltm_lab[sim]'")

from ltm_core.base.types import Float64Array
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_lab.simulator.appearance import palette
from ltm_lab.simulator.canopy import canopy_height
from ltm_lab.simulator.landcover import BARE
from ltm_lab.simulator.mitsuba_scene import SceneBuilder
from ltm_lab.simulator.render import render_range
from ltm_lab.simulator.run import SimulatedSite, make_site, plan_shots
from ltm_lab.simulator.vegetation import LATTICE, Placement, Planting
from ltm_lab.simulator.works import Houses

CONFIG = small_scenario()


@pytest.fixture(scope="module")
def site() -> SimulatedSite:
    return make_site(CONFIG)


@pytest.fixture(scope="module")
def natural() -> SimulatedSite:
    return make_site(small_scenario(lakes=[]))


def _errors(site: SimulatedSite, resolution: float) -> Float64Array:
    """|rendered - traced| range of bare ground (N,) away from silhouettes, the tracer's DEM at `resolution`."""
    shot = plan_shots(CONFIG, site)[0]
    # Bare all over: what grows there is no part of the ground, and most of the work of a scene.
    bare = replace(site.cover, classes=np.full_like(site.cover.classes, BARE), houses=Houses.none())
    view = SceneBuilder(CONFIG, site.terrain, bare).view(shot.pose.position)
    rendered = render_range(view.ground, shot.camera, shot.pose)
    ground = site.terrain.site
    geometry = GridGeometry(0.0, 400.0, resolution, round(400 / resolution), round(400 / resolution))
    elevation = ground.at(*geometry.to_map(*np.mgrid[0 : geometry.height, 0 : geometry.width])).astype(np.float32)
    if resolution == ground.geometry.resolution:
        np.testing.assert_array_equal(elevation, ground.elevation)
    traced = TerrainTracer(Dem(elevation, geometry)).trace(shot.camera, shot.pose).range
    both = np.isfinite(rendered) & np.isfinite(traced)
    nearest = ndimage.minimum_filter(np.where(both, traced, 0), 3)
    smooth = both & (ndimage.maximum_filter(np.where(both, traced, 1e6), 3) - nearest < 0.06 * traced)
    assert smooth.mean() > 0.85
    return np.abs(rendered[smooth].astype(np.float64) - traced[smooth])


def test_the_bare_earth_raster_is_that_ground(natural: SimulatedSite) -> None:
    """The 1 m raster of a ground with 2 m cells rounds its edges, which natural slopes do not show."""
    error = _errors(natural, 1.0)
    assert np.quantile(error, 0.999) < 0.2
    assert error.max() < 0.3


def _soup(placements: list[Placement]) -> Float64Array:
    return np.concatenate(
        [p.prototype.soup.triangles @ m[:3, :3].T + m[:3, 3] for p in placements for m in p.transforms]
    )


def test_canopy_is_what_embreex_sees_from_above(site: SimulatedSite) -> None:
    mesh_construction = pytest.importorskip("embreex.mesh_construction", reason="needs embreex")
    from embreex.rtcore_scene import EmbreeScene

    planting = Planting(site.terrain, site.cover, CONFIG.vegetation, palette(0.2, 1), CONFIG.seed)
    window = GridGeometry(280.0, 350.0, 1.0, 40, 30)
    canopy = canopy_height(planting.everywhere(), site.terrain.site, window)
    near = []
    for p in planting.everywhere():
        x, y = p.transforms[:, 0, 3], p.transforms[:, 1, 3]
        chosen = (x > 265) & (x < 335) & (y > 305) & (y < 365)
        if np.any(chosen):
            near.append(Placement(p.prototype, p.transforms[chosen]))
    scene = EmbreeScene(robust=True)
    mesh_construction.TriangleMesh(scene, np.ascontiguousarray(_soup(near), np.float32))
    n = round(1 / LATTICE)
    x, y = np.meshgrid(280.0 + (np.arange(40 * n) + 0.5) * LATTICE, 350.0 - (np.arange(30 * n) + 0.5) * LATTICE)
    origins = np.stack([x.ravel(), y.ravel(), np.full(x.size, 2000.0)], axis=1).astype(np.float32)
    down = np.tile(np.array([[0.0, 0.0, -1.0]], np.float32), (x.size, 1))
    hit = scene.run(origins, down, output=True)
    height = 2000.0 - hit["tfar"].astype(np.float64) - site.terrain.site.at(x, y).ravel()
    height = np.where(hit["geomID"] >= 0, np.maximum(height, 0), 0).reshape(x.shape)
    seen = height.reshape(30, n, 40, n).max(axis=(1, 3))
    difference = np.abs(seen - canopy)
    assert np.mean(canopy > 1.0) > 0.1
    assert np.mean(difference < 0.02) > 0.995
    assert difference.mean() < 0.01
