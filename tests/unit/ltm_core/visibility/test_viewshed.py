from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
from scenes.rasters import ridge, rough_terrain, standing, tilted_plane

from ltm_core.base.errors import PoseError, RasterError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.visibility.point_visibility import PointVisibility
from ltm_core.visibility.viewshed import PosedCamera, viewshed
from ltm_ros.cli.trace import viewshed as command

CAMERA = Camera(640, 480, 600.0, 600.0, 319.5, 239.5)


def test_cells_that_an_image_hits_are_covered() -> None:
    dem = rough_terrain(5, (181, 263))
    pose = Pose.from_angles(standing(dem, 100.0, 60.0, 25.0), 80.0, -15.0, 5.0)
    traced = TerrainTracer(dem).trace(CAMERA, pose)
    points = traced.points()
    # Pixels that meet the ground right beside a cell's centre say that the centre is seen.
    row, col = dem.geometry.to_grid(points[..., 0], points[..., 1])
    close = np.isfinite(row) & (np.hypot(row - np.rint(row), col - np.rint(col)) < 0.02)
    rows, cols = np.rint(row[close]).astype(int), np.rint(col[close]).astype(int)
    coverage = viewshed(PointVisibility(dem), [PosedCamera("one", CAMERA, pose)], target_height=0.1)
    assert len(rows) > 100
    assert (coverage.count[rows, cols] == 1).mean() > 0.99
    # The other way round: a cell that is seen with several pixels on it is met by one.
    exactly = viewshed(PointVisibility(dem), [PosedCamera("one", CAMERA, pose)])
    hit = np.zeros(dem.geometry.shape, bool)
    cells = traced.cells()
    seen = cells[cells[..., 0] >= 0]
    hit[seen[:, 0], seen[:, 1]] = True
    fine = exactly.footprint < 0.4
    assert fine.sum() > 2000
    assert hit[fine].mean() > 0.995


def test_footprints_of_a_plane() -> None:
    plane = tilted_plane(0.0, 0.0).dem
    pose = Pose.from_angles((1.0, 1.0, 470.0), 0.0, -30.0)
    sight = PointVisibility(plane, curvature=False)
    coverage = viewshed(sight, [PosedCamera("one", CAMERA, pose)])
    row, col = (int(v) for v in plane.geometry.cell_of(1.0, 1.0 + 50.0 / np.tan(np.radians(30.0))))
    _, y = plane.geometry.to_map(row, col)
    distance = float(np.hypot(50.0, y - 1.0))
    assert coverage.footprint[row, col] == pytest.approx(distance / 600 * distance / 50, rel=0.01)
    turned = viewshed(sight, [PosedCamera("one", CAMERA, pose)], all_round=True)
    assert (turned.count == 1).all()
    assert np.isfinite(turned.footprint).all()
    assert turned.footprint[row, col] == pytest.approx(distance / 600 * distance / 50, rel=1e-4)


def test_heights_behind_a_ridge() -> None:
    scene = ridge()
    pose = Pose.from_angles((-390.0, 10.0, 140.0), 90.0)
    sight = PointVisibility(scene.dem, curvature=False)
    coverage = viewshed(sight, [PosedCamera("one", CAMERA, pose)])
    row, col = (int(v) for v in scene.dem.geometry.cell_of(300.0, 10.0))
    x, _ = scene.dem.geometry.to_map(row, col)
    over = 140.0 + (260.0 - 140.0) / 390.0 * (float(x) + 390.0)
    assert coverage.count[row, col] == 0
    assert coverage.height[row, col] == pytest.approx(over - 40.0, abs=0.5)
    high = float(coverage.height[row, col])
    assert viewshed(sight, [PosedCamera("one", CAMERA, pose)], target_height=high + 0.5).count[row, col] == 1
    assert viewshed(sight, [PosedCamera("one", CAMERA, pose)], target_height=high - 0.5).count[row, col] == 0
    behind = scene.dem.geometry.cell_of(-398.0, 10.0)
    assert np.isnan(coverage.height[behind])


def test_trees_hide_the_ground_behind_them() -> None:
    """Trees of 20 m from x = 200 to 240 m, a camera 30 m high at x = 50 m; heights count from bare earth."""
    geometry = GridGeometry(0.0, 100.0, 2.0, 250, 50)
    x, _ = geometry.to_map(0, np.arange(250))
    tops = np.broadcast_to(np.where((x > 200) & (x < 240), 20.0, 0.0), geometry.shape).astype(np.float32)
    ground = Dem(np.zeros(geometry.shape, np.float32), geometry)
    sight = PointVisibility(Dem(tops, geometry), curvature=False)
    view = PosedCamera("one", CAMERA, Pose.from_angles((51.0, 51.0, 30.0), 90.0))
    behind, wood = geometry.cell_of(401.0, 51.0), geometry.cell_of(221.0, 51.0)
    for target, seen in ((0.0, 0), (11.0, 0), (12.0, 1)):
        coverage = viewshed(sight, [view], target_height=target, all_round=True, ground=ground)
        assert coverage.count[behind] == seen
        assert coverage.count[wood] == 1
    assert coverage.height[behind] == pytest.approx(30.0 - 350.0 * 10.0 / 188.0, abs=0.2)
    assert coverage.height[wood] == 20.0


SITE = """
name: ridge
crs: EPSG:32611
origin: [400000.0, 3799000.0]
dem: {path: dem.tif}
cameras:
  north:
    calibration: {width: 320, height: 200, hfov_deg: 60}
    pose: {x: 400060.0, y: 3799930.0, height_above_ground: 12, azimuth_deg: 100, pitch_deg: -10}
  south:
    calibration: {width: 320, height: 200, hfov_deg: 60}
    pose: {x: 400200.0, y: 3799880.0, height_above_ground: 12, azimuth_deg: 300, pitch_deg: -10}
  roving: {}
"""
POSE = """
pose: {x: 400060.0, y: 3799930.0, height_above_ground: 12, azimuth_deg: 100, pitch_deg: -10}
calibration: {width: 320, height: 200, hfov_deg: 60}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    geometry = GridGeometry(400_000.0, 3_800_000.0, 1.0, 263, 181, "EPSG:32611")
    Dem(rough_terrain(61).elevation, geometry).save(tmp_path / "dem.tif")
    (tmp_path / "site.yaml").write_text(SITE)
    (tmp_path / "pose.yaml").write_text(POSE)
    return tmp_path


def test_the_command_maps_a_site(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command(out=folder / "made" / "cover.tif", site=folder / "site.yaml")
    with rasterio.open(folder / "made" / "cover.tif") as source:
        assert source.crs.to_epsg() == 32611
        assert source.bounds == (400_000.0, 3_799_819.0, 400_263.0, 3_800_000.0)
        assert source.descriptions[0] == "cameras that see the cell"
        count, footprint, height = source.read()
    assert set(np.unique(count[np.isfinite(count)])) == {0.0, 1.0, 2.0}
    assert np.isnan(footprint[count == 0]).all()
    assert np.isfinite(footprint[count > 0]).mean() > 0.97
    assert (height[count > 0] <= 0.01).all()
    assert cv2.imread(str(folder / "made" / "cover.png")).shape[1] >= 1200
    said = capsys.readouterr().out
    assert "roving" in said
    assert "seen by 2 or more" in said


def test_range_resolution_and_unknown_ground() -> None:
    plane = tilted_plane(0.0, 0.0).dem
    elevation = plane.elevation.copy()
    elevation[:20] = np.nan
    dem = Dem(elevation, plane.geometry)
    view = PosedCamera("one", CAMERA, Pose.from_angles((1.0, 1.0, 470.0), 0.0, -30.0))
    near = viewshed(PointVisibility(dem), [view], resolution=8.0, max_range=100.0, all_round=True)
    assert near.geometry.shape == (53, 75)
    row, col = np.mgrid[0:53, 0:75]
    x, y = near.geometry.to_map(row, col)
    known = np.isfinite(dem.elevation_at(x, y))
    assert np.array_equal(near.count == -1, ~known)
    assert np.array_equal(near.count[known] == 1, np.hypot(x - 1, y - 1)[known] <= 100.0)


def test_bad_arguments() -> None:
    sight = PointVisibility(tilted_plane(0.0, 0.0).dem)
    view = PosedCamera("one", CAMERA, Pose.from_angles((1.0, 1.0, 470.0), 0.0))
    with pytest.raises(PoseError, match="at least one camera"):
        viewshed(sight, [])
    with pytest.raises(PoseError, match="0 or more metres"):
        viewshed(sight, [view], target_height=-1.0)
    with pytest.raises(RasterError, match="positive metres"):
        viewshed(sight, [view], resolution=0.0)
