from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mitsuba", reason="needs the extra `sim`: pip install './ltm_lab[sim]'")

from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_lab.simulator.landcover import BARE, GRASS, SHRUB, SKY, TREE, LandCover, Stand
from ltm_lab.simulator.mitsuba_scene import EARTH_RADIUS, REFRACTION, EyePointScenes, SceneBuilder
from ltm_lab.simulator.output_io import write_frame, write_index, write_site
from ltm_lab.simulator.render import render_range
from ltm_lab.simulator.run import SimulatedSite, plan_shots, rasters_at, render_shots
from ltm_lab.simulator.scenario import Scenario
from ltm_lab.simulator.terrain_synthesis import HeightField, SyntheticTerrain

SLOPE_X, SLOPE_Y, HEIGHT = 0.12, -0.2, 300.0
CAMERAS = [
    Camera.from_fov(64, 48, 55.0),
    Camera.from_fov(64, 48, 55.0).scaled(4),
    Camera(50, 38, 47.0, 47.0, 21.3, 22.6),
]


def plane_site(classes: UInt8Array | None = None, size: float = 600.0) -> SimulatedSite:
    """A tilted plane of one class, or striped as `classes` (H, W) says; every length in metres."""
    fields = []
    for geometry in (
        GridGeometry(0.0, size, 4.0, round(size / 4), round(size / 4)),
        GridGeometry(-300.0, size + 300.0, 16.0, round((size + 600) / 16), round((size + 600) / 16)),
    ):
        x, y = np.meshgrid(*HeightField(np.empty((0, 0), np.float32), geometry).axes())
        fields.append(HeightField((HEIGHT + SLOPE_X * x + SLOPE_Y * y).astype(np.float32), geometry))
    wide = fields[1].geometry
    grid = GridGeometry(wide.x_min, wide.y_max, 8.0, 2 * wide.width, 2 * wide.height)
    cover = np.full(grid.shape, BARE, np.uint8)
    if classes is not None:
        rows = np.arange(grid.height) * classes.shape[0] // grid.height
        cols = np.arange(grid.width) * classes.shape[1] // grid.width
        cover = classes[rows[:, None], cols[None, :]].astype(np.uint8)
    zeros = np.zeros(grid.shape, np.float32)
    terrain = SyntheticTerrain(fields[0], fields[1], np.full(wide.shape, 3.0, np.float32))
    return SimulatedSite(
        terrain, LandCover(cover, zeros.astype(bool), zeros, zeros, grid, Stand.undisturbed(grid.shape))
    )


def scenario(**changes: Any) -> Scenario:
    values: dict[str, Any] = {
        "name": "plane",
        "seed": 11,
        "image": {"width": 64, "height": 48},
        "truth_step": 2,
        "imaging": {"samples": 2},
        "terrain": {"size": 600.0, "surroundings": 1200.0},
        "vegetation": {"detail_radius": 250.0, "grass_radius": 40.0},
        "cameras": [
            {
                "name": "tower",
                "x": 300.0,
                "y": 180.0,
                "mast": 14.0,
                "patrol": {"azimuth_deg": [10.0, 75.0], "pitch_deg": [-9.0, -14.0], "rounds": 2},
            }
        ],
    }
    return Scenario(**(values | changes))


def plane_range(camera: Camera, pose: Pose, bend: float) -> Float64Array:
    """Slant range r sqrt(1 + s^2) to where z(r) = oz + s r + bend r^2 first meets the plane; +inf where it does not."""
    d = camera.rays() @ pose.rotation.T
    flat = np.hypot(d[..., 0], d[..., 1])
    s = d[..., 2] / flat
    ground = (SLOPE_X * d[..., 0] + SLOPE_Y * d[..., 1]) / flat
    above = pose.position[2] - (HEIGHT + SLOPE_X * pose.position[0] + SLOPE_Y * pose.position[1])
    fall = ground - s
    with np.errstate(invalid="ignore", divide="ignore"):
        r = 2 * above / (fall + np.sqrt(fall * fall - 4 * bend * above))
    return np.where(r > 0, r * np.sqrt(1 + s * s), np.inf)


EYE = np.array([310.0, 150.0, HEIGHT + SLOPE_X * 310 + SLOPE_Y * 150 + 30.0])


@pytest.fixture(scope="module", params=[False, True], ids=["flat", "curved"])
def plane_view(request: pytest.FixtureRequest) -> EyePointScenes:
    """What an eye over the plane sees, without and with the Earth's curvature."""
    site = plane_site()
    view = SceneBuilder(scenario(curvature=request.param), site.terrain, site.cover).view(EYE)
    assert view.bend == pytest.approx((1 - REFRACTION) / (2 * EARTH_RADIUS) if request.param else 0.0)
    return view


@pytest.mark.parametrize("camera", CAMERAS)
def test_range_through_pixel_centres_is_exact_on_a_plane(camera: Camera, plane_view: EyePointScenes) -> None:
    pose = Pose.from_angles(EYE, 20.0, -17.0, 6.0)
    ranges = render_range(plane_view.ground, camera, pose)
    truth = plane_range(camera, pose, plane_view.bend)
    points = pose.position + camera.rays() @ pose.rotation.T * np.where(np.isfinite(truth), truth, 0)[..., None]
    inside = np.isfinite(truth) & np.all((points[..., :2] > 8) & (points[..., :2] < 592), axis=-1)
    assert inside.mean() > 0.5
    np.testing.assert_allclose(ranges[inside], truth[inside], rtol=2e-6, atol=1e-3)
    # A tenth of a pixel would show
    off = Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy + 0.1)
    assert np.abs(plane_range(off, pose, plane_view.bend)[inside] - truth[inside]).max() > 0.1


@pytest.fixture(scope="module")
def planted() -> SimulatedSite:
    stripes = np.array([[GRASS, SHRUB, TREE, BARE, GRASS, SHRUB, TREE, BARE]], np.uint8)
    return plane_site(stripes)


def test_frames_hold_every_class_and_are_a_function_of_the_seed(planted: SimulatedSite) -> None:
    config = scenario()
    shots = plan_shots(config, planted)
    assert [s.stamp_ns - config.start_ns for s in shots] == [0, 2_000_000_000, 4_000_000_000, 6_000_000_000]
    first = list(render_shots(config, planted, shots))
    second = list(render_shots(config, planted, shots[:1]))
    np.testing.assert_array_equal(first[0].image, second[0].image)
    np.testing.assert_array_equal(first[0].truth.labels, second[0].truth.labels)
    # The same pose again: the same light, other noise
    assert not np.array_equal(first[0].image, first[2].image)
    assert np.abs(first[0].image.astype(int) - first[2].image).mean() < 8
    assert set(np.unique([f.truth.labels for f in first])) >= {SKY, GRASS, SHRUB, TREE, BARE}
    for frame in first:
        truth = frame.truth
        assert frame.image.shape == (48, 64, 3)
        assert truth.labels.shape == (24, 32)
        assert truth.camera == frame.shot.camera.scaled(2)
        assert np.all(truth.range_surface <= truth.range_ground)
        np.testing.assert_array_equal(truth.labels == SKY, np.isinf(truth.range_surface))
        tree = truth.labels == TREE
        assert np.all(truth.range_surface[tree] < truth.range_ground[tree])


def test_files_of_a_recording(planted: SimulatedSite, tmp_path: Path) -> None:
    import json

    import rasterio

    config = scenario()
    write_site(tmp_path, config, planted, rasters_at(config, planted))
    shots = plan_shots(config, planted)[:1]
    entries = [write_frame(tmp_path, k, f) for k, f in enumerate(render_shots(config, planted, shots))]
    write_index(tmp_path, config, entries)
    index = json.loads((tmp_path / "frames.json").read_text(encoding="utf-8"))
    entry = index["frames"][0]
    pose = Pose.from_angles(entry["position"], entry["azimuth_deg"], entry["pitch_deg"], entry["roll_deg"])
    np.testing.assert_allclose(pose.rotation, shots[0].pose.rotation, atol=1e-9)
    with np.load(tmp_path / entry["truth"]) as truth:
        assert truth["range_surface"].shape == (24, 32)
    with rasterio.open(tmp_path / "fuel_truth.tif") as raster:
        assert raster.bounds.left % 30 == 15
        assert raster.bounds.top % 30 == 15
        assert raster.crs.to_epsg() == 32611
    with rasterio.open(tmp_path / "dem.tif") as raster:
        assert raster.bounds.left == config.origin[0]
        assert raster.res == (5.0, 5.0)
