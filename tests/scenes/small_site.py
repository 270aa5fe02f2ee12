"""A site small enough for tests: rough terrain, two cameras, a few frames in a bag, and a network that reads colours.

Its ground is painted in squares of two covers, and the photos show that paint where the tracer says the ground is, so
what must come out is known: depth is the tracer's answer, and a fuel cell's class is its square's.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.tracing import TerrainTracer
from ltm_msgs_py.bag.writer import BagWriter
from ltm_msgs_py.image import compressed_to_msg, encode_rgb, image_to_msg
from ltm_msgs_py.pose import pose_to_msg
from ltm_msgs_py.sensors import camera_to_msg
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.topics import CAMERA_INFO, IMAGE_COMPRESSED, IMAGE_RAW, POSE, camera_topic
from scenes.networks import write_classifier
from scenes.rasters import rough_terrain

NAME = "hollow"
SKY, GRASS, BUILT = 0, 1, 6
PAINT = {SKY: (0, 0, 255), GRASS: (0, 255, 0), BUILT: (255, 0, 0)}
SQUARE = 150.0
"""Side of a square of one cover, metres: five fuel cells."""

BEGIN_NS = 1_700_000_000_000_000_000
PERIOD_NS = 250_000_000
YEARS = 1e9
"""Seconds: frames of `BEGIN_NS` are also sent to graphs that live today."""
FRAMES = 6
"""Of each camera."""

TOWER = Camera.from_fov(320, 180, 62.0)
MAST = Camera(256, 144, 210.0, 208.0, 128.5, 70.25, (-0.11, 0.02, 0.0004, -0.0003, 0.0))


@dataclass(frozen=True, eq=False)
class Frame:
    """What a camera took at `stamp_ns`."""

    camera_name: str
    stamp_ns: int
    camera: Camera
    pose: Pose


@dataclass(frozen=True)
class SmallSite:
    """`tower` pans and sends JPEGs, camera_info and poses; `mast` stands still, its site file says all but the image,
    which it sends raw.
    """

    folder: Path

    @property
    def path(self) -> Path:
        return self.folder / "site.yaml"

    @property
    def bag(self) -> Path:
        return self.folder / "recording"

    @cached_property
    def site(self) -> Site:
        return load_site(self.path)

    @cached_property
    def dem(self) -> Dem:
        return self.site.open_dem()

    @cached_property
    def tracer(self) -> TerrainTracer:
        return TerrainTracer(self.dem, self.site.curvature, self.site.refraction, self.site.possible_ground)

    def frames(self, count: int = FRAMES, begin_ns: int = BEGIN_NS) -> list[Frame]:
        """`count` frames of each camera in the order of their stamps, from `begin_ns` on."""
        mast = self.site.camera("mast").pose
        assert mast is not None
        standing = mast.pose(self.dem, self.site.frame)
        frames = []
        for i in range(count):
            stamp = begin_ns + i * PERIOD_NS
            frames.append(Frame("tower", stamp, TOWER, self.tower_pose(20.0 * i)))
            frames.append(Frame("mast", stamp + 100_000_000, MAST, standing))
        return frames

    def tower_pose(self, azimuth_deg: float) -> Pose:
        """Where the tower looks from when it is turned to `azimuth_deg`."""
        x, y = 560.0, 470.0
        return Pose.from_angles((x, y, float(self.dem.elevation_at(x, y)) + 45.0), azimuth_deg, -14.0, 1.5)

    def photo(self, frame: Frame) -> UInt8Array:
        """(H, W, 3) uint8: the painted ground as the camera sees it."""
        points = self.tracer.trace(frame.camera, frame.pose).points()
        image = np.empty((*points.shape[:2], 3), np.uint8)
        image[...] = PAINT[SKY]
        cover = paint_at(points[..., 0], points[..., 1])
        for label in (GRASS, BUILT):
            image[(cover == label) & np.isfinite(points).all(axis=-1)] = PAINT[label]
        return image

    def messages(self) -> dict[Topic, Any]:
        """The inputs of a frame of each camera: the tower's three, the mast's image."""
        tower, mast = self.frames(1)
        return {
            CAMERA_INFO: camera_to_msg(TOWER, tower.stamp_ns, "tower_optical"),
            POSE: pose_to_msg(tower.pose, tower.stamp_ns),
            IMAGE_COMPRESSED: compressed_to_msg(encode_rgb(self.photo(tower)), "jpeg", tower.stamp_ns, "tower_optical"),
            IMAGE_RAW: image_to_msg(self.photo(mast), "rgb8", mast.stamp_ns, "mast_optical"),
        }

    def write_bag(self, path: Path, count: int = FRAMES, begin_ns: int = BEGIN_NS) -> Path:
        """A recording of `count` frames of each camera; every other image comes before its pose."""
        with BagWriter(path) as bag:
            for i, frame in enumerate(self.frames(count, begin_ns)):
                optical, stamp, photo = f"{frame.camera_name}_optical", frame.stamp_ns, self.photo(frame)
                if frame.camera_name == "mast":
                    bag.write(camera_topic(NAME, "mast", IMAGE_RAW), image_to_msg(photo, "rgb8", stamp, optical), stamp)
                    continue
                image = compressed_to_msg(encode_rgb(photo, quality=95), "jpeg", stamp, optical)
                parts = {
                    CAMERA_INFO: camera_to_msg(frame.camera, stamp, optical),
                    POSE: pose_to_msg(frame.pose, stamp),
                    IMAGE_COMPRESSED: image,
                }
                order = list(parts) if i % 4 else list(parts)[::-1]
                for delay, topic in enumerate(order):
                    bag.write(camera_topic(NAME, "tower", topic), parts[topic], stamp + delay * 1_000_000)
        return path


def apart(site: Site) -> Site:
    """With a process for each node, so that a test can kill or stop one alone."""
    return site.model_copy(update={"processes": "node"})


def paint_at(x: NDArray[np.floating], y: NDArray[np.floating]) -> UInt8Array:
    """Cover of the ground at (x, y) of the map frame."""
    with np.errstate(invalid="ignore"):
        odd = (np.floor(x / SQUARE) + np.floor(y / SQUARE)) % 2 == 1
    return np.where(odd, BUILT, GRASS).astype(np.uint8)


def write_small_site(folder: Path, recording: bool = True) -> SmallSite:
    """Write site file, DEM, network and, unless it is not wanted, the recording into an existing empty folder."""
    rough = rough_terrain(7, shape=(90, 120), resolution=10.0, relief=90.0)
    # The map frame's origin lies on the fuel grid, so the painted squares do too.
    Dem(rough.elevation, GridGeometry(480_015.0, 4_150_915.0, 10.0, 120, 90, "EPSG:26911")).save(folder / "dem.tif")
    write_classifier(folder)
    site = {
        "name": NAME,
        "crs": "EPSG:26911",
        "origin": [480_015.0, 4_150_015.0],
        "dem": {"path": "dem.tif"},
        "possible_ground": {"highest": 0.0},
        "model": "colors.yaml",
        "nodes": {"capture": {"max_wait": 1.5}, "fuel_map": {"max_behind": YEARS}, "terrain": {"max_behind": YEARS}},
        "cameras": {
            "tower": {},
            "mast": {
                "image": "raw",
                "calibration": {
                    **{name: getattr(MAST, name) for name in ("width", "height", "fx", "fy", "cx", "cy")},
                    **dict(zip(("k1", "k2", "p1", "p2", "k3"), MAST.distortion, strict=True)),
                },
                "pose": {
                    "x": 480_330.0,
                    "y": 4_150_290.0,
                    "height_above_ground": 30.0,
                    "azimuth_deg": 48.0,
                    "pitch_deg": -12.0,
                },
            },
        },
    }
    (folder / "site.yaml").write_text(yaml.safe_dump(site), encoding="utf-8")
    small = SmallSite(folder)
    if recording:
        small.write_bag(small.bag)
    return small
