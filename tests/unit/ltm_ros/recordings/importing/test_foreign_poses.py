"""Poses of other tools: their own projection formulas give the same pixels as the imported pose and camera.

The examples are small files of our own in the formats of real ones: Metashape camera exports (as EasyIDP reads them),
COLMAP's cameras.txt and images.txt, and OpenSfM's `data/berlin/reconstruction_example.json`."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from pyproj import Transformer
from scenes.rasters import rough_terrain
from scipy.spatial.transform import Rotation

from ltm_core.base.errors import PoseError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.pose import Pose
from ltm_ros.recordings.importing.foreign_poses import (
    UPWARD,
    ForeignPose,
    omega_phi_kappa,
    problem_of,
    read_foreign_poses,
    read_transform,
)

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
    assert camera is not None
    pose = foreign.pose(FRAME)
    return camera.project((points() - (FRAME.x_origin, FRAME.y_origin, 0) - pose.position) @ pose.rotation)


def read_one(path: Path, text: str, tool: str, camera: Camera | None = None) -> ForeignPose:
    path.write_text(text, encoding="utf-8")
    found, poses = read_foreign_poses(path, camera)
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
    assert pose.pose(FRAME, 30.0).position[2] == pytest.approx(AT[2] - 30.0, abs=1e-3)
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
    assert pose.camera is not None
    assert np.allclose(np.array([pose.camera.fx, pose.camera.cx, pose.camera.cy]), (1500.0, 805.0, 590.0))
    placed = pose.pose(FRAME)
    assert np.allclose(placed.position, AT - (FRAME.x_origin, FRAME.y_origin, 0), atol=1e-2)
    assert np.allclose(placed.angles_deg, TRUE.angles_deg, atol=0.005)


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


def test_impossible_poses_are_told(tmp_path: Path) -> None:
    dem = rough_terrain(3)
    ground = float(dem.elevation_at(130.0, -90.0))
    good = Pose(np.array([130.0, -90.0, ground + 20.0]), TRUE.rotation)
    assert problem_of(good, dem) is None
    assert problem_of(Pose(good.position, TRUE.rotation @ UPWARD), dem) is not None
    assert problem_of(Pose(good.position - (0, 0, 25.0), TRUE.rotation), dem) is not None
    assert problem_of(Pose(good.position - (0, 0, 25.0), TRUE.rotation), None) is None
