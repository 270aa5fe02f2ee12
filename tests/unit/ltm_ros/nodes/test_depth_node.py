from pathlib import Path

import numpy as np
import pytest
import yaml
from scenes.depth_scene import CAMERA, STAND_HEIGHT, depth_scene
from scenes.outlets import Kept

from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_msgs_py.image import msg_to_depth
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.nodes.depth import DepthConfig, DepthHandler
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import DEPTH_IMAGE, GROUND_DEPTH, POSED_CAMERA_INFO, POSED_POSE

STAMP = 1_700_000_000_000_000_000


def write_site(folder: Path, with_surface: bool) -> Path:
    dem = depth_scene().dem
    place = dem.geometry
    moved = GridGeometry(
        480_000.0 + place.x_min, 4_150_000.0 + place.y_max, place.resolution, place.width, place.height, "EPSG:26911"
    )
    Dem(dem.elevation, moved).save(folder / "dem.tif")
    rows, cols = np.mgrid[0 : place.height, 0 : place.width]
    x, y = place.to_map(rows, cols)
    stand = (np.abs(x - 60.0) < 70.0) & (np.abs(y - 330.0) < 45.0)
    Dem(np.where(stand, dem.elevation + np.float32(STAND_HEIGHT), dem.elevation), moved).save(folder / "canopy.tif")
    content = {
        "name": "hollow",
        "crs": "EPSG:26911",
        "origin": [480_000.0, 4_150_000.0],
        "dem": {"path": "dem.tif"},
        "cameras": {"mast": {}},
    }
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(content | ({"surface": {"path": "canopy.tif"}} if with_surface else {})))
    return path


def traced(folder: Path, with_surface: bool, *listened: object, **config: object) -> Kept:
    kept = Kept(*listened)
    site = str(write_site(folder, with_surface))
    node = DepthHandler(DepthConfig(site=site, camera="mast", **config), kept, Health())
    node.subscriptions[POSED_CAMERA_INFO](camera_to_msg(CAMERA, STAMP, "mast_optical"))
    node.subscriptions[POSED_POSE](pose_to_msg(depth_scene().traced.pose, STAMP))
    return kept


def test_both_hits_are_kept_where_there_is_a_surface_raster(tmp_path: Path) -> None:
    kept = traced(tmp_path, True, GROUND_DEPTH)
    over, ground = (msg_to_depth(kept.on(topic)[0]) for topic in (DEPTH_IMAGE, GROUND_DEPTH))
    scene = depth_scene()
    # The scene was traced on a flat earth's DEM of the same heights.
    apart = np.isfinite(over) & (over < ground - 2.0)
    assert apart[scene.stand].mean() > 0.9
    assert apart[~scene.stand].mean() < 0.02
    assert kept.stamps(GROUND_DEPTH) == [STAMP]


def test_calibrations_of_too_many_pixels_are_not_traced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """12,000 x 9,000 from a stranger on the inner topic: tracing it took 4.75 GB."""
    kept, health = Kept(), Health()
    node = DepthHandler(DepthConfig(site=str(write_site(tmp_path, False)), camera="mast"), kept, health)

    def trace(*_: object) -> None:
        raise AssertionError("traced")

    monkeypatch.setattr(TerrainTracer, "trace", trace)
    node.subscriptions[POSED_CAMERA_INFO](camera_to_msg(Camera.from_fov(12_000, 9_000, 50.0), STAMP, "mast_optical"))
    node.subscriptions[POSED_POSE](pose_to_msg(depth_scene().traced.pose, STAMP))
    assert kept.sent == []
    assert health.dropped == {"too_large": 1}
    assert "12000 x 9000 pixels; the maximum is 12600000" in health.last_error
