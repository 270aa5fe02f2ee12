"""Poses of other tools: their own projection formulas give the same pixels as the imported pose and camera.

The examples are small files of our own in the formats of real ones: Metashape camera exports (as EasyIDP reads them),
COLMAP's cameras.txt and images.txt, OpenSfM's `data/berlin/reconstruction_example.json`, parameters of `alproj` 1.2
(`alproj/optimize.py`), ImGRAFT's `camera.m` (fullmodel), PRACTISE's `PRACTISE_Input_base.m` (georef_webcam), and the
report of Pic2Map (`reportDialog.py`, `posedialog.py`)."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer
from scenes.rasters import rough_terrain
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.cameras.foreign_camera import UPWARD, ForeignPose, closest_camera, omega_phi_kappa
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_ros.cli.main import cli
from ltm_ros.recordings.importing.foreign_poses import _ALPROJ_TERMS, read_foreign_poses, read_transform
from ltm_ros.recordings.importing.pose_check import Placement, chosen_reading, readings

FRAME = SiteFrame("EPSG:32632", 419_000.0, 6_718_000.0)
AT = np.array([419_169.8, 6_718_421.5, 1215.3])
TRUE = Pose.from_angles((0.0, 0.0, 0.0), 62.0, -7.0, 2.0)
"""Rotation of the examples."""
LENS = Camera(1600, 1200, 1500.0, 1500.0, 805.0, 590.0, (-0.1, 0.02, 0.001, -0.002, 0.003))


def points() -> Float64Array:
    """Places (N, 3) in front of the camera, map metres."""
    rng = np.random.default_rng(1)
    ways = np.column_stack([rng.uniform(-0.4, 0.4, 20), rng.uniform(-0.3, 0.3, 20), np.ones(20)])
    return AT + ways * rng.uniform(100, 900, (20, 1)) @ TRUE.rotation.T


def pixels_of(foreign: ForeignPose, lens: Camera | None = None) -> Float64Array:
    camera = lens or foreign.camera
    pose = foreign.pose(FRAME, lambda x, y: 0.0, 0.0)
    return camera.project((points() - (FRAME.x_origin, FRAME.y_origin, 0) - pose.position) @ pose.rotation)


def read_one(
    path: Path, text: str, tool: str, camera: Camera | None = None, size: tuple[int, int] | None = None
) -> ForeignPose:
    path.write_text(text, encoding="utf-8")
    found, poses = read_foreign_poses(path, size, camera)
    assert found == tool
    assert len(poses) == 1
    return poses[0]


def test_colmap_and_its_similarity(tmp_path: Path) -> None:
    """x = R X + t; OPENCV: k1, k2, p1, p2 as ours; the first pixel's centre is 0.5."""
    about, shift, scale = Rotation.from_euler("xyz", [20, 30, 40], degrees=True), np.array([10.0, -5, 3]), 0.01
    model = (about.inv().apply(AT - shift)) / scale  # AT = scale about model + shift
    to_camera = (about.inv() * Rotation.from_matrix(TRUE.rotation)).inv()
    x, y, z, w = to_camera.as_quat()
    t = -to_camera.apply(model)
    (tmp_path / "cameras.txt").write_text("# list\n7 OPENCV 1600 1200 1500 1500 805.5 590.5 -0.1 0.02 0.001 -0.002\n")
    row = " ".join(map(repr, map(float, (w, x, y, z, *t))))
    (tmp_path / "images.txt").write_text(f"# list\n3 {row} 7 day 1/a b.jpg\n\n", encoding="utf-8")
    qx, qy, qz, qw = about.as_quat()
    (tmp_path / "sim.txt").write_text(" ".join(map(repr, map(float, (scale, qw, qx, qy, qz, *shift)))))
    tool, (pose,) = read_foreign_poses(tmp_path, transform=read_transform(tmp_path / "sim.txt"))
    assert (tool, pose.name) == ("COLMAP", "day 1/a b.jpg")
    lens = Camera(1600, 1200, 1500.0, 1500.0, 805.0, 590.0, (-0.1, 0.02, 0.001, -0.002, 0.0))
    assert pose.camera == lens
    np.testing.assert_allclose(pixels_of(pose), lens.project((points() - AT) @ TRUE.rotation), atol=1e-5)


def test_metashape_in_earth_centred_coordinates(tmp_path: Path) -> None:
    """u = w / 2 + cx + f x', pixels from the corner; its p1 is along x. The chunk is on the ellipsoid."""
    lon, lat = FRAME.to_lonlat(AT[0] - FRAME.x_origin, AT[1] - FRAME.y_origin)
    to_earth = Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    origin = np.array(to_earth.transform(lon, lat, AT[2]))
    axes = []
    for way in np.eye(3):  # of the grid, by small steps
        x, y, z = AT + way
        there = FRAME.to_lonlat(x - FRAME.x_origin, y - FRAME.y_origin)
        step = np.array(to_earth.transform(*there, z)) - origin
        axes.append(step / np.linalg.norm(step))
    rotation = np.array(axes).T @ TRUE.rotation
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    text = f"""<?xml version="1.0" encoding="UTF-8"?><document version="1.4.0"><chunk label="c">
      <sensors><sensor id="0" label="s" type="frame"><resolution width="1600" height="1200"/>
        <calibration type="frame" class="adjusted"><resolution width="1600" height="1200"/><f>1500</f><cx>5.5</cx>
        <cy>-9.5</cy><k1>-0.1</k1><k2>0.02</k2><k3>0.003</k3><p1>-0.002</p1><p2>0.001</p2></calibration></sensor>
      </sensors>
      <cameras><camera id="0" sensor_id="0" label="IMG_1"><transform>{" ".join(map(repr, matrix.ravel().tolist()))}
      </transform></camera><camera id="1" sensor_id="0" label="unaligned"/></cameras>
      <transform><rotation>1 0 0 0 1 0 0 0 1</rotation><translation>{" ".join(map(repr, origin.tolist()))}</translation>
      <scale>1</scale></transform></chunk></document>"""
    pose = read_one(tmp_path / "cameras.xml", text, "Metashape")
    assert pose.camera == LENS
    expected = LENS.project((points() - AT) @ TRUE.rotation)
    np.testing.assert_allclose(pixels_of(pose), expected, atol=0.7)  # the grid's scale of 0.9996
    assert pose.pose(FRAME, lambda x, y: 0.0, 30.0).position[2] == pytest.approx(AT[2] - 30.0, abs=1e-3)
    with pytest.raises(PoseError):
        read_one(tmp_path / "bad.xml", '<!DOCTYPE a [<!ENTITY b "c">]>' + text, "Metashape")


def test_opensfm(tmp_path: Path) -> None:
    """Brown: (f_x x' + c_x) max(w, h) + (w - 1) / 2; metres east, north, up of the reference."""
    lon, lat = map(float, FRAME.to_lonlat(AT[0] - FRAME.x_origin, AT[1] - FRAME.y_origin))
    turn = math.radians(FRAME.grid_convergence_deg(AT[0] - FRAME.x_origin, AT[1] - FRAME.y_origin))
    to_true = Rotation.from_euler("z", -turn)
    to_camera = (to_true * Rotation.from_matrix(TRUE.rotation)).inv()
    shot = {
        "camera": "v2 sony",
        "rotation": to_camera.as_rotvec().tolist(),
        "translation": (-to_camera.apply([0.0, 0.0, 15.3])).tolist(),
    }
    camera = {
        "projection_type": "brown", "width": 1600, "height": 1200, "focal_x": 1500 / 1600, "focal_y": 1500 / 1600,
        "c_x": 5.5 / 1600, "c_y": -9.5 / 1600, "k1": -0.1, "k2": 0.02, "k3": 0.003, "p1": 0.001, "p2": -0.002,
    }  # fmt: skip
    (tmp_path / "reference_lla.json").write_text(json.dumps({"latitude": lat, "longitude": lon, "altitude": 1200.0}))
    content = json.dumps([{"cameras": {"v2 sony": camera}, "shots": {"02.jpg": shot}, "points": {}}])
    pose = read_one(tmp_path / "reconstruction.json", content, "OpenSfM")
    assert np.allclose(np.array([pose.camera.fx, pose.camera.cx, pose.camera.cy]), (1500.0, 805.0, 590.0))
    placed = pose.pose(FRAME, lambda x, y: 0.0, 0.0)
    assert np.allclose(placed.position, AT - (FRAME.x_origin, FRAME.y_origin, 0), atol=1e-2)
    assert np.allclose(placed.angles_deg, TRUE.angles_deg, atol=0.005)


@pytest.mark.parametrize("distorted", [False, True])
def test_alproj(tmp_path: Path, distorted: bool) -> None:
    """`project` of alproj 1.2: u = w - (K E X)_u, then its distortion about (cx, cy)."""
    terms = {"k1": 0.03, "k2": 0.01, "p1": 0.002, "s1": 0.001, "a1": 0.001} if distorted else {}
    p = {"x": AT[0], "y": AT[1], "z": AT[2], "fov": 56.0, "pan": 62.0, "tilt": -7.0, "roll": 2.0, "w": 1600, "h": 1200,
         "cx": 800, "cy": 600, **dict.fromkeys(_ALPROJ_TERMS, 0.0),
         **terms}  # fmt: skip
    pan, tilt, roll = math.radians(62.0), math.radians(-(-7.0 + 90)), math.radians(-2.0)
    z = np.array([[math.cos(pan), -math.sin(pan), 0], [math.sin(pan), math.cos(pan), 0], [0, 0, 1]])
    x = np.array([[1, 0, 0], [0, math.cos(tilt), -math.sin(tilt)], [0, math.sin(tilt), math.cos(tilt)]])
    y = np.array([[math.cos(roll), 0, math.sin(roll)], [0, 1, 0], [-math.sin(roll), 0, math.cos(roll)]])
    way = (points() - AT) @ (x @ y @ z).T
    f = 800 / math.tan(math.radians(28.0))
    uv = np.column_stack([1600 - (f * way[:, 0] / way[:, 2] + 800), f * way[:, 1] / way[:, 2] + 600])
    a, b = ((uv - (800, 600)) / (800, 600)).T
    r = a * a + b * b
    over = p["k1"] * r + p["k2"] * r**2
    u = a * (1 + over) + 2 * p["p1"] * a * b + p["s1"] * r
    v = b * (1 + p["a1"] + over) + p["p1"] * (r + 2 * b * b)
    expected = np.column_stack([u, v]) * (800, 600) + (800, 600)
    if distorted:  # its radius is an ellipse's, so no lens of ours is exact
        with pytest.raises(PoseError, match="px"):
            read_one(tmp_path / "params.json", json.dumps(p), "alproj")
    else:
        np.testing.assert_allclose(
            pixels_of(read_one(tmp_path / "params.json", json.dumps(p), "alproj")), expected, atol=1e-6
        )


def test_imgraft(tmp_path: Path) -> None:
    """`project` of camera.m, with yaw 0 east and pixels from 1."""
    v = [*AT, 1200, 1600, math.radians(28.0), math.radians(-7.0), math.radians(2.0), 1500, 1500, 806, 591,
         -0.1, 0.02, 0.003, 0, 0, 0, 0, 0]  # fmt: skip
    c, s = np.cos(v[5:8]), np.sin(v[5:8])
    rows = np.array([
        [s[2] * s[1] * c[0] - c[2] * s[0], s[2] * s[1] * s[0] + c[2] * c[0], s[2] * c[1]],
        [c[2] * s[1] * c[0] + s[2] * s[0], c[2] * s[1] * s[0] - s[2] * c[0], c[2] * c[1]],
        [c[1] * c[0], c[1] * s[0], -s[1]],
    ])  # fmt: skip
    rows[:2] *= -1
    way = (points() - AT) @ rows.T
    if (way[:, 2] < 0).all():
        pytest.fail("the example looks away from its points")
    x, y = (way[:, :2] / way[:, 2:]).T
    r = x * x + y * y
    a = 1 - 0.1 * r + 0.02 * r**2 + 0.003 * r**3
    expected = np.column_stack([1500 * a * x + 806 - 1, 1500 * a * y + 591 - 1])
    pose = read_one(tmp_path / "cam.txt", "% fullmodel\n" + " ".join(map(repr, map(float, v))), "ImGRAFT")
    np.testing.assert_allclose(pixels_of(pose), expected, atol=1e-3)


def test_pic2map(tmp_path: Path) -> None:
    """u = u0 - f (R0 d) / (R2 d) with d west, north, up."""
    tilt, heading, swing = math.radians(83.0), math.radians(-62.0), math.radians(-2.0)
    text = (
        f"Pose estimation parameters:\nX position, Free : {-AT[0]} (Precision : 0.5)\nY Position, Free : {AT[1]} "
        f"(Precision : 0.5)\nZ Position, Fixed: {AT[2]}\nTilt [rad], Free : {tilt} (Precision : 0.1)\n"
        f"Heading [rad], Free : {heading} (Precision : 0.1)\nSwing [rad], Free : {swing} (Precision : 0.1)\n"
        "Focal [pixel], Free : 1500.0 (Precision : 2)\n"
    )
    (st, sa, ss), (ct, ca, cs) = np.sin([tilt, heading, swing]), np.cos([tilt, heading, swing])
    r0 = [-ca * cs - sa * ct * ss, sa * cs - ca * ct * ss, -st * ss]
    r1 = [ca * ss - sa * ct * cs, -sa * ss - ca * ct * cs, -st * cs]
    r2 = [-sa * st, -ca * st, ct]
    d = (points() - AT) * (-1, 1, 1)
    expected = np.column_stack([800 - 1500 * (d @ r0) / (d @ r2), 600 - 1500 * (d @ r1) / (d @ r2)]) - 0.5
    pose = read_one(tmp_path / "report.txt", text, "Pic2Map", size=(1600, 1200))
    np.testing.assert_allclose(pixels_of(pose), expected, atol=1e-6)


def test_practise_aims_at_its_target(tmp_path: Path) -> None:
    text = (
        "vs=1;\ncam(:,1)=[6.142488e+05, 5.163441e+06]; % altitude will be calculated!\n"
        "cam(:,2)=[6.184486e+05, 5.157440e+06];\ncam_off=[6, 40]; \ncam_rol=0; \ncam_foc=0.018;\ncam_hei=0.0148;\n"
        "cam_wid=0.0222;\n"
    )
    pose = read_one(tmp_path / "Input.m", text, "PRACTISE", size=(2220, 1480))
    frame = SiteFrame("EPSG:32632", 614_000.0, 5_163_000.0)
    placement = Placement(frame, None, 0.0)
    object.__setattr__(placement, "ground", lambda x, y: 2000.0 if abs(x - 248.8) < 1 else 1500.0)
    placed = placement.placed(pose)
    away = math.hypot(4199.8, 6001.0)
    assert placed.pose.position[2] == 2006.0
    azimuth, pitch, _ = placed.pose.angles_deg
    assert azimuth == pytest.approx(math.degrees(math.atan2(4199.8, -6001.0)))
    assert pitch == pytest.approx(math.degrees(math.atan2(1540.0 - 2006.0, away)))
    assert placed.camera.fx == pytest.approx(1800.0)


def angles_of(unit: float) -> Float64Array:
    matrix = TRUE.rotation @ UPWARD
    phi = math.asin(matrix[0, 2])
    return np.array([math.atan2(-matrix[1, 2], matrix[2, 2]), phi, math.atan2(-matrix[0, 1], matrix[0, 0])]) / unit


@pytest.mark.parametrize(("unit", "name"), [(math.pi / 180, "degrees"), (math.pi / 200, "gon"), (1.0, "radians")])
def test_omega_phi_kappa(tmp_path: Path, unit: float, name: str) -> None:
    angles = angles_of(unit)
    np.testing.assert_allclose(omega_phi_kappa(angles * unit), TRUE.rotation, atol=1e-12)
    text = f"#PhotoID, X, Y, Z, Omega, Phi, Kappa [{name}]\nIMG_1\t" + "\t".join(map(repr, map(float, (*AT, *angles))))
    pose = read_one(tmp_path / "opk.txt", text, "omega, phi, kappa", LENS)
    np.testing.assert_allclose(pixels_of(pose), LENS.project((points() - AT) @ TRUE.rotation), atol=1e-6)


def test_a_lens_that_no_terms_of_ours_reproduce_is_rejected() -> None:
    start = Camera(1600, 1200, 1500.0, 1500.0, 800.0, 600.0)
    assert closest_camera(start, LENS.project, "a").distortion == pytest.approx(LENS.distortion, abs=1e-4)
    with pytest.raises(PoseError, match="px"):
        closest_camera(start, lambda rays: start.project(rays) + 20 * np.sin(rays * 30)[:, :2], "a")


def test_readings_of_wrong_axes_are_found(tmp_path: Path) -> None:
    """A pose with other axes is rejected with the reading that is possible; one below the ground is rejected."""
    dem = rough_terrain(3)
    x, y = 130.0, -90.0
    ground = float(dem.elevation_at(x, y))
    frame = SiteFrame(dem.geometry.crs or "EPSG:32632", 0.0, 0.0)
    good = ForeignPose("a", "a", np.array([x, y, ground + 20.0]), TRUE.rotation, LENS)
    placement = Placement(frame, dem, 0.0)
    assert chosen_reading(readings([good], placement, {})).how == "as stated"
    flipped = good.with_rotation(good.rotation @ UPWARD)
    with pytest.raises(PoseError, match="y up, z backward"):
        chosen_reading(readings([flipped], placement, {}))
    swapped = ForeignPose("a", "a", np.array([y, x, ground + 20.0]), TRUE.rotation, LENS)
    with pytest.raises(PoseError, match="outside the DEM"):
        chosen_reading(readings([swapped], placement, {}))
    below = ForeignPose("a", "a", np.array([x, y, ground - 5.0]), TRUE.rotation, LENS)
    with pytest.raises(PoseError, match=r"5\.0 m|below|under"):
        chosen_reading(readings([below], placement, {}))


@pytest.mark.parametrize(("metres", "said"), [(20.0, "not tested"), (2000.0, "1990 m above the ground")])
def test_heights_that_no_photo_tests_are_doubted(tmp_path: Path, metres: float, said: str) -> None:
    dem = Dem(np.full((20, 20), 10.0, np.float32), GridGeometry(419_000.0, 6_718_600.0, 30.0, 20, 20, FRAME.crs))
    dem.save(tmp_path / "dem.tif")
    (tmp_path / "poses.txt").write_text(f"IMG_1.jpg 419300 6718300 {metres} 90 0 0\n")
    options = ["--focal", "1500px", "--size", "1600x1200", "--dem", str(tmp_path / "dem.tif")]
    result = CliRunner().invoke(
        cli, ["pose", "import", str(tmp_path / "poses.txt"), "--out", str(tmp_path / "out"), *options]
    )
    assert said in " ".join(result.output.split())
    assert (tmp_path / "out/IMG_1.yaml").exists()
