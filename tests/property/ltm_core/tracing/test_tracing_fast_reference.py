"""The fast path against the float64 reference, pixel by pixel: on ridged ground, under trees, with holes, in real
mountains, and over a stack of real mountains with a finer patch.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scenes.rasters import rough_terrain
from scenes.traced_terrain import (
    assert_same,
    big_tujunga,
    margin_only,
    random_camera,
    random_pose,
    riddled,
    ridged,
    treed_and_holed,
)

from ltm_core.base.errors import PoseError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_stack import DemStack
from ltm_core.tracing import TerrainTracer
from ltm_lab.tracers.reference import trace_reference

WIDTH, HEIGHT = 50, 40


def assert_exact(dem: Dem, seed: int, rays: int) -> None:
    """`rays` pixels of the profile's way, `WIDTH` x `HEIGHT` a random pose, are the reference's."""
    rng = np.random.default_rng(seed)
    tracer = TerrainTracer(dem)
    compared = hits = unknown = by_profile = 0
    while compared < rays:
        camera, pose = random_camera(rng, WIDTH, HEIGHT), random_pose(dem, rng)
        held = tracer.statistics.profile_bytes
        try:
            fast = tracer.trace(camera, pose, way="profile").range
        except PoseError:  # in a lake, below its rim
            continue
        directions = (camera.rays() @ pose.rotation.T).reshape(-1, 3)
        slow = trace_reference(dem, pose.position, directions, tracer.bend)
        assert_same(fast, slow, pose)
        compared += slow.size
        hits += int(np.isfinite(slow).sum())
        unknown += int(np.isnan(slow).sum())
        by_profile += tracer.statistics.profile_bytes != held
    assert hits > 0.2 * compared
    assert by_profile > 0.5 * compared / (WIDTH * HEIGHT)
    print(f"{compared} pixels, {hits} hits, {unknown} unknown, 0 wrong")


@pytest.mark.parametrize("scene", [ridged, treed_and_holed, margin_only])
def test_some_pixels(scene: Callable[[int], Dem]) -> None:
    assert_exact(scene(400), 21, rays=2_000)


@pytest.mark.slow
@pytest.mark.parametrize("holes", [False, True])
def test_twenty_thousand_pixels_of_real_mountains(shared_data: Path, holes: bool) -> None:
    dem = big_tujunga(shared_data)
    assert_exact(riddled(dem) if holes else dem, 23, rays=20_000)


def real_stack(data: Path) -> DemStack:
    """30 m mountains of 48 x 48 km, and on their highest peak a patch of 4.1 x 3.5 km and 5 m with made-up detail."""
    coarse = Dem.open(data / "fuels_socal_santaana_gridfire" / "dem.tif")
    coarse = coarse.in_frame(SiteFrame(str(coarse.geometry.crs), coarse.geometry.x_min, coarse.geometry.y_min))
    row, col = np.unravel_index(int(np.nanargmax(coarse.elevation)), coarse.elevation.shape)
    x, y = (float(v) for v in coarse.geometry.to_map(row, col))
    geometry = GridGeometry(x - 2211.3, y + 1733.7, 5.0, 820, 700)
    rows, cols = np.mgrid[0:700, 0:820]
    detail = rough_terrain(3, (700, 820), relief=25.0).elevation - 808.0
    fine = coarse.elevation_at(*geometry.to_map(rows, cols)) + detail
    return DemStack([Dem(fine.astype(np.float32), geometry), coarse])


@pytest.mark.slow
def test_twenty_thousand_pixels_of_a_stack_of_real_mountains(shared_data: Path) -> None:
    assert_exact(real_stack(shared_data), 24, rays=20_000)


def test_far_ridges_stand_where_there_was_sky(shared_data: Path) -> None:
    """Around the peak: the pixels whose ray leaves the fine patch meet ground up to 30 km away."""
    stack = real_stack(shared_data)
    fine = stack.levels[0]
    x, y = (float(v) for v in fine.geometry.to_map(346, 442))
    camera = Camera.from_fov(640, 100, 90.0)
    alone, around = TerrainTracer(fine), TerrainTracer(stack)
    gained = 0
    for azimuth in (0.0, 180.0):
        pose = Pose.from_angles((x, y, float(stack.elevation_at(x, y)) + 15.0), azimuth, -4.0)
        near, far = alone.trace(camera, pose, "profile").range, around.trace(camera, pose, "profile").range
        assert not (np.isfinite(near) & ~np.isfinite(far)).any()
        gained += int((np.isfinite(far) & ~np.isfinite(near)).sum())
        assert np.nanmax(np.where(np.isfinite(far), far, np.nan)) > 8_000
    assert gained > 0.1 * 2 * camera.width * camera.height
