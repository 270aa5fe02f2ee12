"""A small site with a phone as its camera, and what a phone stores of a photo there."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ltm_core.base.types import UInt8Array
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_lab.simulator.phone_photo_io import PhonePhoto
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.pose import msg_to_covariance, msg_to_pose
from ltm_msgs_py.sensors import msg_to_camera
from ltm_msgs_py.stamp import stamp_of

LON, LAT = -118.06, 34.225
ORIGIN = (402_000.0, 3_787_000.0)
FRAME = SiteFrame("EPSG:32611", *ORIGIN)
GROUND = 1500.0
STAMP = 1_720_143_015_250_000_000
"""2024-07-05 01:30:15.25 UTC."""
LONG, SHORT = 64, 40
FX = 27.0 / math.hypot(36.0, 24.0) * math.hypot(LONG, SHORT)
"""Focal length in pixels of a lens of 27 mm (35 mm equivalent)."""


def phone_site(folder: Path) -> Site:
    """A slope that falls eastward by a tenth, GROUND metres high at LON, LAT; its one camera is `phone`."""
    x, y = (float(v) for v in FRAME.from_lonlat(LON, LAT))
    grid = GridGeometry(x + ORIGIN[0] - 300.0, y + ORIGIN[1] + 240.0, 10.0, 60, 48, "EPSG:32611")
    centres, _ = grid.to_map(0, np.arange(60))
    slope = np.tile(GROUND - 0.1 * (centres - x - ORIGIN[0]), (48, 1))
    Dem(slope.astype(np.float32), grid).save(folder / "dem.tif")
    document = {"name": "ridge", "crs": "EPSG:32611", "origin": list(ORIGIN), "dem": {"path": "dem.tif"}}
    (folder / "site.yaml").write_text(yaml.safe_dump(document | {"cameras": {"phone": {}}}))
    return load_site(folder / "site.yaml")


def picture(portrait: bool = False) -> UInt8Array:
    """Darker to its left and top."""
    v, u = np.mgrid[0:SHORT, 0:LONG]
    image = np.stack([u * 3, v * 5, 255 - u * 2], axis=-1).astype(np.uint8)
    return np.ascontiguousarray(image.transpose(1, 0, 2)) if portrait else image


def taken(
    number: int,
    angles_deg: tuple[float, float, float],
    at: tuple[float, float, float] = (0.0, 0.0, 1.6),
    portrait: bool = False,
) -> PhonePhoto:
    """A photo `at` so many metres east, north and above GROUND of LON, LAT, ten seconds after the one before."""
    x, y = (float(v) for v in FRAME.from_lonlat(LON, LAT))
    place = (x + at[0], y + at[1], GROUND + at[2])
    width, height = (SHORT, LONG) if portrait else (LONG, SHORT)
    camera = Camera(width, height, FX, FX, (width - 1) / 2, (height - 1) / 2)
    stamp = STAMP + number * 10_000_000_000
    return PhonePhoto(f"IMG_{number}.jpg", picture(portrait), camera, Pose.from_angles(place, *angles_deg), stamp, 4.0)


def imported(bag: Path, camera: str = "phone", site: str = "ridge") -> list[tuple[int, Camera, Pose, Any]]:
    """(stamp, camera, pose, covariance) of each photo in a bag."""
    reader = BagReader(bag)
    rows: dict[str, list[Any]] = {"camera_info": [], "pose": []}
    for message in reader.messages():
        name = message.topic.removeprefix(f"/{site}/{camera}/")
        if name in rows:
            rows[name].append(reader.decode(message))
    return [
        (stamp_of(pose), msg_to_camera(info), msg_to_pose(pose, "map"), msg_to_covariance(pose))
        for info, pose in zip(rows["camera_info"], rows["pose"], strict=True)
    ]
