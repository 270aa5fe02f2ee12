"""What several unit tests share because it is costly to make."""

from pathlib import Path

import numpy as np
import pytest
from scenes.rerun_site import LABELS, STAMP, hills, site

from ltm_core.base.errors import ImageError
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras, one of them known from the site file, one frame each."""
    pytest.importorskip("rerun", reason="the viewer's extra is not installed")
    from ltm_ros.viewer import RerunView

    path = tmp_path_factory.mktemp("rrd") / "deep" / "site.rrd"
    calibration = {"width": 640, "height": 360, "hfov_deg": 50}
    pose = {"x": 386_300.0, "y": 3_796_400.0, "height_above_ground": 20.0, "azimuth_deg": 190.0}
    dem = hills()
    where = site(north={"calibration": calibration, "pose": pose}, south={})
    view = RerunView("ltm ridge", where, dem, LABELS, save=path)
    rng = np.random.default_rng(3)
    for name, azimuth in (("north", 190.0), ("south", 20.0)):
        camera = Camera.from_fov(1920, 1080, 50.0)
        view.log_pose(name, STAMP, Pose.from_angles((300.0, 400.0, 600.0), azimuth, -5.0), camera)
        rgb = np.full((1080, 1920, 3), (200, 100, 30), np.uint8)
        view.log_image(name, STAMP, rgb)
        depth = np.full((1080, 1920), 700.0, np.float32)
        depth[:300] = np.inf
        view.log_depth(name, STAMP, depth, camera)
        fused = depth.copy()
        fused[600:] = 690.0
        view.log_fusion(name, STAMP, fused, depth, network=None if name == "south" else depth[::4, ::4])
        labels = np.zeros((1080, 1920), np.uint8)
        labels[400:] = 3
        view.log_labels(name, STAMP, labels)
        view.log_points(name, STAMP, rng.normal(0, 300, (40_000, 3)), rng.integers(0, 255, (40_000, 3), np.uint8))
    geometry = where.fuel_geometry(dem)
    classes = np.full(geometry.shape, 255, np.uint8)
    classes[20:30, 40:55] = 2
    view.log_fuel_map(STAMP, classes, geometry)
    kinds = np.full((300, 450), 255, np.uint8)
    kinds[50:200, 60:250] = 0
    kinds[80:90, 100:140] = 1
    view.log_change(STAMP, kinds, GridGeometry(0.0, 300.0, 1.0, 450, 300))
    cells = np.array([[80, 100], [80, 101], [7, 3]], np.int32)
    points = np.array([[100.5, 219.5, 480.0], [101.5, 219.5, 481.0], [3.5, 292.5, 470.0]], np.float32)
    view.log_changed_cells(STAMP, cells, points, np.array([1, 1, 2], np.uint8))
    view.log_changed_cells(STAMP + 9, cells[1:2], points[1:2], np.array([0], np.uint8))
    with pytest.raises(ImageError, match="south"):
        view.log_depth("south", STAMP, depth[:, :-1], camera)
    with pytest.raises(ImageError, match="south"):
        view.log_fusion("south", STAMP, depth[:, :-1], depth)
    view.close()
    return path
