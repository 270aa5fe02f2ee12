from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes.rasters import rough_terrain
from typer.testing import CliRunner

from ltm_core.fuel.class_map import write_fuel_map
from ltm_core.fuel.votes import CellVotes
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.site.site_io import load_site
from ltm_core.tracing import TerrainTracer
from ltm_core.vision.labels import LabelSet
from ltm_lab.cli.main import cli
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.grid import classes_to_msg
from ltm_msgs_py.image import compressed_to_msg, depth_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pointcloud import votes_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.recordings.recorded_run import Recorded

CAMERA = Camera.from_fov(96, 60, 60.0)
SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Two cameras with two headings each over rough terrain, with every result and truth."""
    folder = tmp_path_factory.mktemp("run")
    terrain = rough_terrain(5, (110, 140), 8.0, y_max=880.0)
    x_min, y_max, resolution = terrain.geometry.x_min, terrain.geometry.y_max, terrain.geometry.resolution
    height, width = terrain.elevation.shape
    Dem(terrain.elevation, GridGeometry(x_min + 501_000, y_max + 2000, resolution, width, height, "EPSG:32611")).save(
        folder / "dem.tif"
    )
    (folder / "site.yaml").write_text(
        "name: ridge\ncrs: EPSG:32611\norigin: [501000, 2000]\ndem: {path: dem.tif}\ncameras: {north: {}, east: {}}\n"
    )
    site = load_site(folder / "site.yaml")
    grid = site.fuel_geometry(site.open_dem())
    labels = LabelSet.load()
    classes = (np.indices(grid.shape).sum(axis=0) % 3 + 1).astype(np.uint8)
    tracer = TerrainTracer(terrain, curvature=False)
    x0, y0, x1, y1 = terrain.geometry.bounds
    with BagWriter(folder / "recording") as bag:
        for number, name in enumerate(("north", "east")):
            x, y = x0 + (0.4 + 0.2 * number) * (x1 - x0), y0 + 0.5 * (y1 - y0)
            z = float(terrain.elevation_at(x, y)) + 30
            for turn in range(2):
                stamp = (turn + 1) * SECOND
                pose = Pose.from_angles((x, y, z), 60.0 + 50 * turn, -8.0)
                depth = tracer.trace(CAMERA, pose).depth()
                ids = np.where(np.isfinite(depth), 2, 0).astype(np.uint8)
                photo = np.full((60, 96, 3), (120, 140, 90), np.uint8)
                rows, cols = (a.ravel().astype(np.int32) for a in np.nonzero(classes == 1 + number))
                counts = np.zeros((len(rows), len(labels)), np.uint32)
                counts[:, 1 + number] = 5
                votes = CellVotes(grid, rows, cols, counts, np.zeros(len(rows), np.float32), stamp, name)
                for topic, message in {
                    "camera_info": camera_to_msg(CAMERA, stamp, "c"),
                    "pose": pose_to_msg(pose, stamp),
                    "image_raw/compressed": compressed_to_msg(encode_rgb(photo), "jpeg", stamp, "c"),
                    "depth/image": depth_to_msg(depth + 2, stamp, "c"),
                    "labels/image": image_to_msg(ids, "mono8", stamp, "c"),
                    "fuel/votes": votes_to_msg(votes, labels.names),
                    "truth/camera_info": camera_to_msg(CAMERA.scaled(2), stamp, "c"),
                    "truth/depth": depth_to_msg(depth[::2, ::2], stamp, "c"),
                    "truth/ground_depth": depth_to_msg(depth[::2, ::2], stamp, "c"),
                    "truth/labels": image_to_msg(ids[::2, ::2], "mono8", stamp, "c"),
                }.items():
                    bag.write(f"/ridge/{name}/{topic}", message, stamp)
        bag.write("/ridge/fuel_map", classes_to_msg(classes, grid, 3 * SECOND), 3 * SECOND)
    write_fuel_map(folder / "fuel_truth.tif", classes, site.in_crs(grid), labels)
    return Recorded.find(folder / "recording")


def test_command_writes_the_page(recorded: Recorded, tmp_path: Path) -> None:
    out = tmp_path / "report"
    result = CliRunner().invoke(cli, ["eval", str(recorded.bag), "--report", str(out)])
    assert result.exit_code == 0, result.output
    page = (out / "report.html").read_text()
    pictures = sorted(path.name for path in out.glob("*.png"))
    assert "depth_1_north.png" in pictures
    for name in pictures:
        assert name in page
    assert page.count("data:image/jpeg;base64,") >= len(pictures)
    assert "http://" not in page.replace("http://www.w3.org", "")
    for words in ("traced, surface", "macro mean", "depth, network"):
        assert words in page
    assert "nan" not in page.lower().replace("nanometre", "").split("data:image")[0]
