"""Tracing over stacks: every ray as the float64 reference, by the profile and by the pyramid; no seam shows."""

import numpy as np
import pytest
from scenes.rasters import directions, rough_terrain, sampled, with_holes
from scenes.traced_terrain import assert_same

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.raster.dem_stack import DemStack
from ltm_core.tracing import TerrainTracer
from ltm_core.visibility.footprint import line_of_sight_vectors
from ltm_core.visibility.point_visibility import PointVisibility
from ltm_lab.tracers.reference import trace_reference


def stack(seed: int, offset: float = 0.0, ratio: float = 7.3, shift: tuple[float, float] = (0.37, 0.71)) -> DemStack:
    """A rough fine raster, `offset` metres too high, somewhere in a coarse one whose nodes do not fall on its own."""
    coarse = rough_terrain(seed, (61, 83), resolution=ratio, relief=140.0, x_min=-1000.0, y_max=400.0)
    x_min, y_max = -1000.0 + (23 + shift[0]) * ratio, 400.0 - (17 + shift[1]) * ratio
    geometry = GridGeometry(x_min, y_max, 1.0, 197, 151)
    row, col = np.mgrid[0:151, 0:197]
    detail = rough_terrain(seed + 100, (151, 197), relief=9.0).elevation - 800.0
    heights = coarse.elevation_at(*geometry.to_map(row, col)) + detail + offset
    return DemStack([Dem(heights.astype(np.float32), geometry), coarse])


def three_levels(seed: int) -> DemStack:
    far = rough_terrain(seed, (47, 59), resolution=30.0, relief=300.0, x_min=-500.0, y_max=900.0)
    made: list[Dem] = [far]
    for resolution, (height, width), (x_min, y_max) in (
        (6.0, (83, 101), (-201.3, 507.7)),
        (1.5, (121, 97), (-33.9, 301.1)),
    ):
        geometry = GridGeometry(x_min, y_max, resolution, width, height)
        row, col = np.mgrid[0:height, 0:width]
        detail = rough_terrain(seed + width, (height, width), relief=4 * resolution).elevation - 800.0
        made.insert(0, Dem((made[0].elevation_at(*geometry.to_map(row, col)) + detail).astype(np.float32), geometry))
    return DemStack(made)


def holed(whole: DemStack, seed: int, margin: bool) -> DemStack:
    """The same after the fitting, with holes in both levels that nothing fills."""
    levels = [with_holes(level, seed + k, margin=margin) for k, level in enumerate(whole.levels)]
    return DemStack(levels, fitted=True)


def positions(dem: DemStack, rng: np.random.Generator, count: int) -> list[Float64Array]:
    """Above known ground of each level, and beyond them all."""
    found: list[Float64Array] = []
    while len(found) < count:
        x_min, y_min, x_max, y_max = dem.levels[int(rng.integers(len(dem.levels)))].geometry.bounds
        x, y = rng.uniform(x_min - 20, x_max + 20), rng.uniform(y_min - 20, y_max + 20)
        ground = float(dem.elevation_at(x, y))
        above = float(rng.choice([0.3, 2.0, 10.0, 60.0]))
        found.append(np.array([x, y, (ground if np.isfinite(ground) else 900.0) + above]))
    return found


CASES = {
    "fitted": lambda: stack(1),
    "13 m too high": lambda: stack(2, 13.0),
    "aligned": lambda: stack(3, -6.0, ratio=8.0, shift=(0.0, 0.5)),
    "three levels": lambda: three_levels(4),
    "holes": lambda: holed(stack(5), 50, margin=False),
    "holes and margins": lambda: holed(three_levels(6), 60, margin=True),
}


@pytest.mark.parametrize("case", CASES)
def test_rays_against_the_reference(case: str) -> None:
    dem = CASES[case]()
    tracer = TerrainTracer(dem)
    rng = np.random.default_rng(len(case))
    kinds = []
    for position in positions(dem, rng, 10):
        rays = directions(rng, 250)
        try:
            fast = tracer.trace_rays(position, rays)
        except PoseError:  # in a lake, below its rim
            continue
        assert_same(fast, trace_reference(dem, position, rays, tracer.bend), position)
        kinds.append(fast)
    seen = np.concatenate(kinds)
    assert np.isfinite(seen).mean() > 0.25
    assert np.isinf(seen).any()
    assert np.isnan(seen).any()


@pytest.mark.parametrize("case", CASES)
def test_the_profile_sees_what_the_pyramid_sees(case: str) -> None:
    dem = CASES[case]()
    tracer = TerrainTracer(dem)
    rng = np.random.default_rng(7 + len(case))
    beyond = served = 0
    for position in positions(dem, rng, 15):
        camera = Camera.from_fov(83, 61, float(rng.uniform(5, 90)))
        pose = Pose.from_angles(position, rng.uniform(0, 360), rng.uniform(-30, 8), rng.uniform(-30, 30))
        try:
            fast, slow = (tracer.trace(camera, pose, way) for way in ("profile", "pyramid"))
        except PoseError:
            continue
        assert_same(fast.range, slow.range.astype(np.float64), pose)
        places = fast.points()[np.isfinite(fast.range)]
        row, col = dem.geometry.to_grid(places[:, 0], places[:, 1])
        beyond += int((~dem.geometry.contains(row.round().astype(int), col.round().astype(int))).sum())
        served += tracer.statistics.profile_bytes > 0
    assert beyond > 1000
    assert served > 3


def test_a_plane_has_no_seam() -> None:
    """Both levels sample one plane: every range is the closed form's, across the seam and back."""
    east, north = 0.083, -0.041

    def plane(x: Float64Array, y: Float64Array) -> Float64Array:
        return 500.0 + east * x + north * y

    coarse = sampled(plane, GridGeometry(-3000.0, 2500.0, 30.0, 210, 171)).dem
    fine = sampled(plane, GridGeometry(-207.3, 183.1, 1.0, 391, 287)).dem
    tracer = TerrainTracer(DemStack([fine, coarse]), curvature=False)
    rng = np.random.default_rng(9)
    for x, y in ((12.3, 7.7), (182.9, -103.0), (-1211.0, 640.0)):
        origin = np.array([x, y, float(plane(np.array(x), np.array(y))) + 25.0])
        rays = directions(rng, 20_000, -40, -3)
        met = tracer.trace_rays(origin, rays)
        approach = east * rays[:, 0] + north * rays[:, 1] - rays[:, 2]
        expected = np.where(approach > 0, 25.0 / np.where(approach > 0, approach, 1.0), np.inf)
        reached = np.abs(origin[:2] + expected[:, None] * rays[:, :2])
        inside = (reached[:, 0] < 2950) & (reached[:, 1] < 2400)
        assert inside.sum() > 15_000
        # 25 m of height over a grazing ray: float32 nodes round the plane by 0.03 mm.
        assert np.abs(met[inside] / expected[inside] - 1).max() < 1e-5


@pytest.mark.parametrize("case", ["three levels", "holes and margins"])
def test_lines_of_sight_agree_with_the_tracer(case: str) -> None:
    dem = CASES[case]()
    sight, tracer, rng = PointVisibility(dem), TerrainTracer(dem), np.random.default_rng(11)
    x_min, y_min, x_max, y_max = dem.levels[-1].geometry.bounds
    judged = 0
    for position in positions(dem, rng, 6):
        if np.isnan(dem.elevation_at(position[0], position[1])):
            continue
        x, y = rng.uniform(x_min, x_max, 3000), rng.uniform(y_min, y_max, 3000)
        points = np.column_stack([x, y, dem.elevation_at(x, y) + rng.choice([0.0, 0.3, 8.0], 3000)])
        points = points[np.isfinite(points[:, 2])]
        lift, unknown = sight.lifts(position, points)
        hidden = ~unknown & (lift > 1e-3)
        assert hidden.any()
        for shift in (0.02, -0.02):
            rays = line_of_sight_vectors(position, points + np.outer(lift + shift, [0, 0, 1]), sight.bend)
            distance, met = np.linalg.norm(rays, axis=1), tracer.trace_rays(position, rays)
            said = ~np.isnan(met) & ~unknown
            if shift > 0:
                assert (met[said] >= distance[said] - 5e-3).all()
            else:
                assert (met[said & hidden] <= distance[said & hidden] + 5e-3).all()
            judged += int(said.sum())
    assert judged > 1000
