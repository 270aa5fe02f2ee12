"""A small site with a living surface, and what its cameras send of a surface that has changed."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ltm_core.base.types import BoolArray, UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.tracing import TerrainTracer
from ltm_core.tracing.possible_ground import NOTHING_BEYOND
from ltm_msgs_py.image import depth_to_msg, image_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.runtime.topics import LABELS_IMAGE, MEASURED_DEPTH, MEASURED_SIGMA, POSED_CAMERA_INFO, POSED_POSE
from scenes.networks import write_depth_network
from scenes.small_site import MAST, PAINT, SKY, SmallSite, write_small_site

HOUR = 3_600_000_000_000
SURE = np.diag([1e-4] * 3 + [1e-10] * 3)
NEAR = 40.0
"""Metres: the depth that a photo of `photo_of_depth` shows in full green."""
BLOCK_AT = (500.0, 445.0)
"""(x, y) of what stands in the mast's view since, `BLOCK_HEIGHT` over 80 x 80 m."""
BLOCK_HEIGHT = 20.0


def write_terrain_site(folder: Path, recording: bool = True, **content: Any) -> SmallSite:
    """The small site with a section `terrain`; `content`: more of its file."""
    small = write_small_site(folder, recording)
    whole = yaml.safe_load(small.path.read_text())
    whole |= {"terrain": {}, "expert": {"terrain": {"threshold": 2.0, "register_frames": False}}}
    small.path.write_text(yaml.safe_dump(whole | content))
    return SmallSite(small.folder)


def write_fusing_site(folder: Path, recording: bool = True, **content: Any) -> SmallSite:
    """One whose depth network reads inverse depth off the photo's green channel, and whose surface is the DEM. Such
    photos are no landscapes, so nobody judges whether the sun stood high enough for them."""
    write_depth_network(folder)
    fusing = {"depth_model": "depth.yaml", "surface": {"path": "dem.tif"}}
    small = write_terrain_site(folder, recording, **fusing, **content)
    whole = yaml.safe_load(small.path.read_text())
    whole["expert"]["cameras"] = {name: {"judge_pictures": False} for name in whole["cameras"]}
    small.path.write_text(yaml.safe_dump(whole))
    return SmallSite(small.folder)


def sunk(small: SmallSite) -> Dem:
    """Every second square of 12 x 12 cells is 9 m lower than the site's DEM says."""
    row, col = np.mgrid[0 : small.dem.geometry.height, 0 : small.dem.geometry.width]
    return Dem(small.dem.elevation - 9.0 * ((row // 12 + col // 12) % 2 == 0), small.dem.geometry)


def block_cells(small: SmallSite) -> BoolArray:
    """(H, W) of the site's DEM: where the block stands."""
    row, col = (int(v) for v in small.dem.geometry.cell_of(*BLOCK_AT))
    cells = np.zeros(small.dem.elevation.shape, np.bool_)
    cells[row - 4 : row + 4, col - 4 : col + 4] = True
    return cells


def built_up(small: SmallSite) -> Dem:
    """The site's DEM with the block on it."""
    return Dem(small.dem.elevation + np.float32(BLOCK_HEIGHT) * block_cells(small), small.dem.geometry)


def mast_pose(small: SmallSite) -> Pose:
    """Where the site file puts the mast."""
    standing = small.site.camera("mast").pose
    assert standing is not None
    return standing.pose(small.dem, small.site.frame)


def photo_of_depth(surface: Dem, camera: Camera, pose: Pose) -> UInt8Array:
    """(H, W, 3): inverse depth in green, sky blue."""
    depth = TerrainTracer(surface, possible=NOTHING_BEYOND).trace(camera, pose).depth()
    land = np.isfinite(depth)
    photo = np.zeros((*depth.shape, 3), np.uint8)
    photo[..., 1] = np.where(land, np.round(255 * NEAR / np.where(land, depth, 1e9)).clip(1, 255), 0)
    photo[~land] = PAINT[SKY]
    return photo


def measured_messages(small: SmallSite, surface: Dem, stamp: int, raised: float = 15.0) -> dict[Any, Any]:
    """What would be measured of a surface from the mast if it stood `raised` metres higher, by topic."""
    pose = mast_pose(small)
    pose = Pose(pose.position + np.array([0.0, 0.0, raised]), pose.rotation)
    depth = TerrainTracer(surface, possible=NOTHING_BEYOND).trace(MAST, pose).depth()
    ids = np.full(depth.shape, 3, np.uint8)
    frame = "mast_optical"
    return {
        LABELS_IMAGE: image_to_msg(ids, "mono8", stamp, frame),
        POSED_CAMERA_INFO: camera_to_msg(MAST, stamp, frame),
        POSED_POSE: pose_to_msg(pose, stamp, covariance=SURE),
        MEASURED_SIGMA: depth_to_msg(np.full(depth.shape, 0.5, np.float32), stamp, frame),
        MEASURED_DEPTH: depth_to_msg(depth, stamp, frame),
    }
