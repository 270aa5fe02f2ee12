"""Time of a query on a large terrain: 10 km x 10 km at 1 m within a raster of 25 m out to 40 km."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from ltm_core.base.errors import RegionError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import ray_bend
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.pose_covariance import pose_covariance
from ltm_core.locating.locator import Locator
from ltm_core.locating.region import marked_box, marked_pixel
from ltm_core.locating.settings import LocatingConfig
from ltm_core.locating.sighting import Sighting
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_stack import DemStack
from ltm_core.visibility.point_visibility import project
from ltm_lab.bench.mountains import ridged_terrain
from ltm_lab.evaluation.locating.smoke_sites import ranged_mountains

_CAMERA = Camera.from_fov(1920, 1080, 60.0)


@dataclass(frozen=True)
class QueryTime:
    """Milliseconds, median over queries at different pixels; `cpu`: processor time of all threads."""

    query: str
    wall: float
    cpu: float
    count: int


def large_stack(size: int = 10_000) -> Dem:
    """Synthetic mountains of `size` x `size` m at 1 m in coarser ones that reach 40 km farther."""
    fine = ridged_terrain(size)
    coarse = ranged_mountains(5, round((size + 80_000) / 25.0), 25.0)
    around = GridGeometry(-40_000.0, size + 40_000.0, 25.0, coarse.geometry.width, coarse.geometry.height)
    return DemStack([fine, Dem(coarse.elevation, around)])


def query_times(dem: Dem, count: int = 24) -> list[QueryTime]:
    """Of one camera's pixel on the ground, of smoke in a pixel and in a box, and of two cameras' smoke."""
    bend = ray_bend(True, 0.13)
    locator = Locator(dem, bend, LocatingConfig())
    x_min, y_min, x_max, y_max = dem.geometry.bounds
    rng = np.random.default_rng(3)
    poses = []
    for share in (0.35, 0.62):
        x, y = x_min + share * (x_max - x_min), y_min + 0.4 * (y_max - y_min)
        z = float(dem.elevation_at(x, y)) + 60.0
        poses.append(Pose.from_angles((x, y, z), 20.0 - 60.0 * (share > 0.5), -3.0))
    covariances = [pose_covariance(pose, 0.5, 0.5, 0.1, 0.1, 0.1) for pose in poses]
    found = []
    for name in ("pixel", "smoke, pixel", "smoke, box", "smoke, two cameras"):
        walls: list[float] = []
        cpus: list[float] = []
        for turn in range(8 * count):
            if len(walls) == count:
                break
            u, v = rng.uniform(100, 1800), rng.uniform(350, 700)
            marks = [marked_pixel(_CAMERA, (u, v), 2.0)]
            if name.endswith("box"):
                marks = [marked_box(_CAMERA, (u, v - 60, u + 50, v), 2.0, 0.04, True)]
            first = [Sighting("camera_0", _CAMERA, poses[0], covariances[0], marks[0])]
            try:
                sightings = first if not name.endswith("cameras") else _with_other(locator, first, poses, covariances)
                before, cpu = time.perf_counter(), time.process_time()
                locator.locate(sightings, smoke=name != "pixel")
            except RegionError:
                continue
            if turn > 0:  # the first compiles
                walls.append(1000 * (time.perf_counter() - before))
                cpus.append(1000 * (time.process_time() - cpu))
        if walls:
            found.append(QueryTime(name, float(np.median(walls)), float(np.median(cpus)), len(walls)))
    return found


def _with_other(
    locator: Locator, first: list[Sighting], poses: list[Pose], covariances: list[Float64Array]
) -> list[Sighting]:
    """The other camera's sighting of what the first one marks. Raises RegionError where it does not show it."""
    x, y = locator.locate(first).posterior.likeliest
    place = np.array([[x, y, float(locator.dem.elevation_at(x, y))]])
    pixel = project(_CAMERA, poses[1], place, locator.bend)[0]
    mark = marked_pixel(_CAMERA, pixel, 2.0)
    return [*first, Sighting("camera_1", _CAMERA, poses[1], covariances[1], mark)]
