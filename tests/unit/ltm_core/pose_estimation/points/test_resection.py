import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scenes.rasters import rough_terrain
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from ltm_core.base.errors import ConfigError, PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame, ray_bend
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.pose_estimation.points.control_points import ControlPoints
from ltm_core.pose_estimation.points.resection import resect, traced_errors
from ltm_core.pose_estimation.points.resection_io import read_control_points
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.trace_io import load_picture_config
from ltm_core.visibility.footprint import line_of_sight_vectors, pixel_rays
from ltm_ros.cli.main import cli
from ltm_ros.cli.trace import trace as trace_command

CAMERA = Camera(1600, 1100, 1850.0, 1850.0, 801.0, 547.0, (-0.12, 0.0, 0.0, 0.0, 0.0))
START = replace(CAMERA, fx=1500.0, fy=1500.0, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
POSE = Pose.from_angles((120.0, -340.0, 812.0), 203.0, -8.0, 3.0)
BEND = ray_bend(True, 0.13)


def marked(
    pixels: Float64Array, distances: Float64Array, camera: Camera = CAMERA, pose: Pose = POSE, bend: float = BEND
) -> ControlPoints:
    """Points at slant distances behind pixels; the curved ray's height is the straight one's plus bend r^2."""
    ways = pixel_rays(camera, pixels) @ pose.rotation.T * distances[:, None]
    ways[:, 2] += bend * (ways[:, 0] ** 2 + ways[:, 1] ** 2)
    names = tuple(f"p{k}" for k in range(len(pixels)))
    return ControlPoints(names, pose.position + ways, pixels)


def scattered(count: int = 12, seed: int = 1, noise: float = 0.0, **kind: object) -> ControlPoints:
    rng = np.random.default_rng(seed)
    pixels = np.column_stack([rng.uniform(20, 1580, count), rng.uniform(20, 1080, count)])
    points = marked(pixels, rng.uniform(400, 3000, count), **kind)  # type: ignore[arg-type]
    return replace(points, pixels=np.clip(pixels + rng.normal(0, noise, pixels.shape), 0, (1599, 1099)))


def moved(points: ControlPoints, shifts: dict[int, tuple[float, float]]) -> ControlPoints:
    pixels = points.pixels.copy()
    for index, shift in shifts.items():
        pixels[index] += shift
    return replace(points, pixels=pixels)


def turn_between(a: Pose, b: Pose) -> float:
    """Degrees."""
    return float(np.degrees(Rotation.from_matrix(a.rotation.T @ b.rotation).magnitude()))


def test_finds_angles_focal_length_and_k1_without_any_angle() -> None:
    result = resect(scattered(), START, POSE.position, bend=BEND)
    assert turn_between(result.pose, POSE) < 1e-6
    assert result.camera.fx == pytest.approx(1850.0, abs=1e-4)
    assert result.camera.distortion[0] == pytest.approx(-0.12, abs=1e-6)
    assert result.residual_px.max() < 1e-5
    assert result.fitted == ("focal", "k1")
    assert result.used.all()
    assert not result.held


@pytest.mark.parametrize("start", [(-80.0, 75.0, 60.0), (-1500.0, 4700.0, 300.0)])
def test_a_free_position_is_found_from_far_away(start: tuple[float, float, float]) -> None:
    points = moved(scattered(9, noise=0.5), {4: (200.0, -80.0)})
    camera = replace(CAMERA, fx=1500.0, fy=1500.0)
    result = resect(points, camera, POSE.position + start, free=("focal", "position"), bend=BEND)
    assert result.fitted == ("focal", "position")
    assert np.linalg.norm(result.pose.position - POSE.position) < 3.0
    assert turn_between(result.pose, POSE) < 0.1
    assert result.outliers == ("p4",)


def test_a_position_with_a_sigma_is_not_held_at_a_wrong_place() -> None:
    """Points from 20 m on, and a place that is 3 m off: held, it turns the camera; free, it is corrected."""
    rng = np.random.default_rng(5)
    pixels = np.column_stack([rng.uniform(20, 1580, 12), rng.uniform(20, 1080, 12)])
    points = marked(pixels, np.geomspace(20, 2000, 12))
    off = POSE.position + np.array([2.0, 1.5, -1.7])
    result = resect(points, CAMERA, off, free=("position",), bend=BEND, position_sigma=3.0)
    assert result.used.all()
    assert turn_between(result.pose, POSE) < 0.01
    assert np.linalg.norm(result.pose.position - POSE.position) < 0.05
    far = resect(marked(pixels, np.full(12, 4000.0)), CAMERA, off, free=("position",), bend=BEND, position_sigma=3.0)
    assert far.fitted == ("position",), "far points do not determine the place; its sigma does"
    assert far.sigmas["x"] <= 3.0


def test_sigmas_are_those_that_noise_makes() -> None:
    # The mean normalised squared error of the fitted values is their number, 5; over 10 runs its sigma is 1.
    normalised = []
    for seed in range(10):
        result = resect(scattered(seed=seed, noise=2.0), START, POSE.position, (203.0, -8.0, 3.0), bend=BEND)
        turn = Rotation.from_matrix(POSE.rotation @ result.pose.rotation.T).as_rotvec()
        error = np.array([*turn, np.log(1850.0 / result.camera.fx), -0.12 - result.camera.distortion[0]])
        normalised.append(error @ np.linalg.solve(result.covariance, error))
    # The pixel's sigma is estimated from 19 spare observations, which raises the mean to 5 x 19 / 17.
    assert 3.7 < np.mean(normalised) < 8.0


def test_gross_errors_are_named_and_left_out() -> None:
    points = moved(scattered(noise=1.0), {3: (-300.0, 20.0), 8: (40.0, 60.0)})
    result = resect(points, START, POSE.position, bend=BEND)
    assert result.outliers == ("p3", "p8")
    assert turn_between(result.pose, POSE) < 0.1
    assert result.residual_px[3] > 250


def in_line() -> ControlPoints:
    """Seven points in one line, which no position follows from."""
    at = np.linspace(0, 1, 7)[:, None]
    start = POSE.position + 900 * POSE.rotation @ [-0.35, 0.1, 1]
    end = POSE.position + 1500 * POSE.rotation @ [0.35, -0.1, 1]
    places = start + at * (end - start)
    pixels = CAMERA.project(line_of_sight_vectors(POSE.position, places, BEND) @ POSE.rotation)
    return ControlPoints(tuple("abcdefg"), places, pixels)


def test_position_is_held_where_the_points_lie_in_one_line() -> None:
    points = in_line()
    result = resect(points, CAMERA, POSE.position, free=("position",), bend=BEND)
    assert "one line" in result.held["position"]
    assert turn_between(result.pose, POSE) < 1e-6
    assert np.array_equal(result.pose.position, POSE.position)
    known = resect(points, CAMERA, POSE.position, free=("position",), bend=BEND, position_sigma=5.0)
    assert known.fitted == ("position",)
    assert not known.held
    assert known.sigmas["x"] < 5.1


WALL = GridGeometry(-60.0, 305.0, 1.0, 121, 310)
"""Level ground at 10 m around a wall of 40 m, from y = 120 to 125."""


def test_what_the_dem_says_of_each_point() -> None:
    _, y = WALL.to_map(np.arange(310)[:, None] + np.zeros((1, 121)), np.arange(121)[None] + np.zeros((310, 1)))
    dem = Dem(np.where((y > 120) & (y < 125), 40.0, 10.0).astype(np.float32), WALL)
    pose = Pose.from_angles((0.0, 5.0, 60.0), 0.0, -15.0)
    camera = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)
    places = {
        "on the ground": (-20.0, 80.0, 10.0),
        "in the ground": (22.0, 100.0, 2.0),
        "behind the wall": (10.0, 130.0, 10.0),
        "buried behind the wall": (-15.0, 131.0, 4.0),
        "on a pole on the wall": (-30.0, 122.0, 52.0),
        "beyond the raster": (40.0, 420.0, 70.0),
    }
    xyz = np.array(list(places.values()))
    pixels = camera.project(line_of_sight_vectors(pose.position, xyz, 0.0) @ pose.rotation)
    result = resect(ControlPoints(tuple(places), xyz, pixels), camera, pose.position, free=())
    traced = traced_errors(result, TerrainTracer(dem, curvature=False))
    said = dict(zip(places, map(str, traced.states), strict=True))
    assert said == {
        "on the ground": "seen",
        "in the ground": "hidden",
        "behind the wall": "hidden",
        "buried behind the wall": "hidden",
        "on a pole on the wall": "above its surface",
        "beyond the raster": "beside the DEM",
    }
    assert traced.visible.tolist() == [True] + [False] * 5
    assert traced.above_ground[:5] == pytest.approx([0, -8, 0, -6, 12], abs=0.01)
    assert np.isnan(traced.above_ground[5])
    assert not traced.met[5]


def test_many_wrong_points_are_named() -> None:
    points = moved(scattered(noise=1.0), {1: (-250.0, 90.0), 4: (150.0, 60.0), 6: (30.0, 200.0), 9: (190.0, -90.0)})
    with pytest.raises(PoseError, match="4 of 12 control points do not fit a common pose") as caught:
        resect(points, START, POSE.position, bend=BEND)
    assert all(name in str(caught.value) for name in ("p1 (off by", "p4 (off by", "p6 (off by", "p9 (off by"))


def test_points_given_twice_or_not_finite_are_named() -> None:
    points = scattered(4)
    with pytest.raises(PoseError, match="same name: a, a"):
        replace(points, names=("a", "b", "a", "c"))
    with pytest.raises(PoseError, match="same pixel: p0, p3"):
        replace(points, pixels=points.pixels[[0, 1, 2, 0]])
    places = points.places.copy()
    places[2, 1] = np.nan
    with pytest.raises(PoseError, match="p2"):
        replace(points, places=places)


FRAME = SiteFrame("EPSG:32611", 400_000.0, 3_799_000.0)


@pytest.mark.parametrize(
    "text",
    [
        "\ufeffName,Easting,Northing,Height,u,v\nrock,400010.5,3799020.25,812.5,33,44\n",
        "label;image_x;image_y;altitude;map_y;map_x\nrock;33;44;812.5;3799020.25;400010.5\n",
    ],
)
def test_reads_control_points_by_their_column_names(tmp_path: Path, text: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    points = read_control_points(path, FRAME, first_pixel=1.0)
    assert points.names == ("rock",)
    assert points.places.tolist() == [[10.5, 20.25, 812.5]]
    assert points.pixels.tolist() == [[32.0, 43.0]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id,x,y,z,u\na,1,2,3,4\n", "no column 'v'"),
        ("id,x,y,z,u,v\na,1,2,3,4,5\nb,1,2,high,4,5\n", "line 3: z is 'high', not a number .point b"),
        ("id,x,y,z,u,v\na,1,2,3,4\n", "line 2: v is None"),
        ("id,x,y,z,u,v\n", "no row"),
        ("", "no column 'x'"),
    ],
)
def test_bad_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(PoseError, match=message):
        read_control_points(path, FRAME)


GUESS = """
pose: {x: 400120.5, y: 3799880.25, height_above_ground: 30}
calibration: {width: 320, height: 200, fx: 260}
"""


def write_points(path: Path, points: ControlPoints, first_pixel: float = 0.0, frame: SiteFrame | None = None) -> Path:
    """With the coordinates of a frame, without one as they are."""
    shift = (frame.x_origin, frame.y_origin, 0.0) if frame else (0.0, 0.0, 0.0)
    rows = np.column_stack([points.places + shift, points.pixels + first_pixel]).tolist()
    lines = [",".join([name, *map(str, row)]) for name, row in zip(points.names, rows, strict=True)]
    path.write_text("\n".join(["id,x,y,z,u,v", *lines]))
    return path


def pose_command(**options: object) -> None:
    """`ltm pose points` with these options."""
    given = [str(options.pop("points"))]
    for name, value in options.items():
        given += [f"--{name.replace('_', '-')}"] + ([] if value is True else [str(value)])
    result = CliRunner().invoke(cli, ["pose", "points", *given])
    print(result.output)
    if result.exception is not None:
        raise result.exception


def test_the_command_writes_a_pose_that_trace_reads(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    terrain = Dem(rough_terrain(61).elevation, GridGeometry(400_000.0, 3_800_000.0, 1.0, 263, 181, "EPSG:32611"))
    terrain.save(tmp_path / "dem.tif")
    camera = Camera(320, 200, 300.0, 300.0, 159.5, 99.5)
    position = np.array([400120.5, 3799880.25, float(terrain.elevation_at(400120.5, 3799880.25)) + 30.0])
    truth = Pose.from_angles(position, 312.0, -20.0, 2.0)
    pixels = np.array([[20.0, 150.0], [290.0, 160.0], [150.0, 60.0], [40.0, 40.0], [280.0, 30.0], [160.0, 180.0]])
    points = marked(pixels, np.array([50.0, 60.0, 90.0, 140.0, 150.0, 45.0]), camera, truth)
    names = ("[/cairn]", *points.names[1:])  # as somebody may write it, no markup of tables
    table = write_points(tmp_path / "points.csv", replace(points, names=names, pixels=pixels), 1.0)
    (tmp_path / "guess.yaml").write_text(GUESS)
    fitted, dem = tmp_path / "pose.yaml", tmp_path / "dem.tif"
    files = {"points": table, "guess": tmp_path / "guess.yaml", "report": tmp_path / "report.json"}
    pose_command(**files, out=fitted, dem=dem, first_pixel=1.0)
    config = load_picture_config(fitted)
    assert (config.pose.azimuth_deg, config.pose.pitch_deg, config.pose.roll_deg) == pytest.approx(
        (312.0, -20.0, 2.0), abs=1e-3
    )
    assert config.calibration.fx == pytest.approx(300.0, abs=0.01)
    stated = json.loads((tmp_path / "report.json").read_text())["sigmas"]
    assert config.pose.azimuth_sigma_deg == pytest.approx(stated["azimuth_deg"], rel=0.01)
    assert config.pose.position_sigma is None
    assert (config.pose.x, config.pose.y, config.pose.z) == pytest.approx(tuple(position), abs=1e-3)
    said = capsys.readouterr().out
    assert "traced against surveyed" in said
    assert "[/cairn]" in said
    assert "inf" not in said.lower().replace("info", "")
    assert "median residual 0.00 px" in said
    assert '"pose_covariance"' in (tmp_path / "report.json").read_text()
    trace_command(dem=[dem], pose=fitted, out=tmp_path / "traced")
    assert (tmp_path / "traced" / "depth.tif").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"free": ("p1",)}, "cannot fit p1"),
        ({"sigma_px": 0.0}, "must be positive"),
        ({"position_sigma": -1.0}, "positive metres"),
        ({"position": (0.0, np.nan, 0.0)}, "three finite metres"),
    ],
)
def test_bad_arguments(change: dict[str, object], message: str) -> None:
    with pytest.raises(PoseError, match=message):
        resect(scattered(), START, **({"position": POSE.position} | change))  # type: ignore[arg-type]


def test_the_command_needs_a_crs_where_there_is_no_dem(tmp_path: Path) -> None:
    (tmp_path / "guess.yaml").write_text("pose: {x: 1, y: 2, z: 3}\ncalibration: {width: 320, height: 200, fx: 260}\n")
    with pytest.raises(ConfigError, match="--crs"):
        pose_command(points=tmp_path / "no.csv", guess=tmp_path / "guess.yaml", out=tmp_path / "pose.yaml")


def test_an_outlier_widens_the_stated_errors_by_as_much_as_a_point_at_the_limit() -> None:
    points = scattered(20, noise=3.0)
    near, far = (
        resect(moved(points, {3: (shift, 0.0)}), CAMERA, POSE.position, free=(), bend=BEND) for shift in (40.0, -300.0)
    )
    assert near.outliers == far.outliers == ("p3",)
    rest = far.residual_px[far.used]
    trimmed = np.sqrt(np.sum(rest**2) / (2 * rest.size - 3))
    assert 1.1 * trimmed < far.sigma_px < 1.7 * trimmed
    assert near.sigma_px == pytest.approx(far.sigma_px, rel=0.02)
