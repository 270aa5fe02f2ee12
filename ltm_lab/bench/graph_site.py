"""Makes the site of the graph's load test: as many cameras as asked for, with the frames of the demo's towers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import yaml
from rclpy.serialization import deserialize_message, serialize_message

from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_msgs_py.bag.reader import BagReader
from ltm_msgs_py.camera_info import camera_to_msg, msg_to_camera
from ltm_msgs_py.image import compressed_to_msg, compressed_to_rgb, encode_rgb
from ltm_msgs_py.stamp import stamp_of
from ltm_ros.runtime.topics import CAMERA_INFO, IMAGE_COMPRESSED, POSE, camera_topic

Layout = Literal["site", "node"]
NAME = "bench"
SENT = {"info": CAMERA_INFO, "pose": POSE, "image": IMAGE_COMPRESSED}
"""What a camera sends of each frame, in this order; the names are the suffixes of its files."""
MOST_CAMERAS = 1000
"""Of a bench; a stamp's last digits are the number of its camera."""


def stamp_of_frame(now_ns: int, camera: int) -> int:
    """Unique over all cameras, so that an update of the map names its frame and its camera (`camera_of`)."""
    return now_ns // MOST_CAMERAS * MOST_CAMERAS + camera


def camera_of(stamp: int) -> int:
    """Number of the camera that sent the frame of this stamp."""
    return stamp % MOST_CAMERAS


@dataclass(frozen=True)
class Load:
    """What a site of the load test consists of.

    `fusion`: whether it has a depth network. `processes`: as in a site file; None: the default there. `patrol`: whether
    cameras turn as the demo's towers do; else each sends one view again and again. `width`: of the photos, pixels; the
    demo's are enlarged. `dem_size`: cells a side of the DEM; None: the demo's as it is, else resampled. `terrain`:
    whether the surface is kept up to date, too.
    """

    cameras: int
    fusion: bool = True
    processes: Layout | None = None
    patrol: bool = True
    width: int = 1920
    dem_size: int | None = None
    terrain: bool = False


@dataclass(frozen=True)
class Traffic:
    """`frames`: how many different ones each camera's folder holds, as `<number>.<part>.cdr`."""

    site: Path
    cameras: tuple[str, ...]
    frames: int


def write_site(folder: Path, demo: Path, load: Load) -> Traffic:
    """Site file and serialised frames in `folder`; camera i looks as tower i modulo the number of towers, each of them
    beginning with another frame."""
    original = load_site(demo / "site.yaml")
    names = tuple(f"c{number:02d}" for number in range(load.cameras))
    content = {
        "name": NAME,
        "crs": original.crs,
        "origin": list(original.origin),
        "dem": {"path": str(_dem(folder, (demo / "dem.tif").resolve(), load.dem_size))},
        "fuel": {"prior": str((demo / "prior.tif").resolve())},
        "depth_model": original.depth_model if load.fusion else "",
        "cameras": {name: {} for name in names},
    }
    content |= {} if load.processes is None else {"processes": load.processes}
    content |= {"terrain": {}} if load.terrain else {}
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    towers = [_enlarged(frames, load.width) for frames in _frames_of(original, BagReader(demo / "recording"))]
    for number, name in enumerate(names):
        frames = towers[number % len(towers)]
        first = number // len(towers)
        (folder / name).mkdir()
        for at in range(len(frames) if load.patrol else 1):
            for part, cdr in frames[(at + first) % len(frames)].items():
                (folder / name / f"{at:03d}.{part}.cdr").write_bytes(cdr)
    return Traffic(path, names, min(map(len, towers)) if load.patrol else 1)


def _dem(folder: Path, demo: Path, size: int | None) -> Path:
    """The demo's, or the same terrain in as many cells as asked for."""
    if size is None:
        return demo
    dem = Dem.open(demo)
    place = dem.geometry
    heights = cv2.resize(dem.elevation, (size, size), interpolation=cv2.INTER_LINEAR)
    finer = replace(place, resolution=place.resolution * place.width / size, width=size, height=size)
    Dem(np.asarray(heights, np.float32), finer).save(folder / "dem.tif")
    return folder / "dem.tif"


def _enlarged(frames: list[dict[str, bytes]], width: int) -> list[dict[str, bytes]]:
    """With photos and calibrations of another width, at the same field of view."""
    return [frame | _resized(frame, width) for frame in frames]


def _resized(frame: dict[str, bytes], width: int) -> dict[str, bytes]:
    info, image = (deserialize_message(frame[part], SENT[part].type) for part in ("info", "image"))
    camera = msg_to_camera(info)
    if camera.width == width:
        return {}
    larger = camera.resized(width, round(camera.height * width / camera.width))
    photo = cv2.resize(compressed_to_rgb(image), (larger.width, larger.height), interpolation=cv2.INTER_CUBIC)
    jpeg = encode_rgb(np.asarray(photo, np.uint8))
    return {
        "info": serialize_message(camera_to_msg(larger, stamp_of(info), info.header.frame_id)),
        "image": serialize_message(compressed_to_msg(jpeg, "jpeg", stamp_of(image), image.header.frame_id)),
    }


def _frames_of(site: Site, reader: BagReader) -> list[list[dict[str, bytes]]]:
    """Of each camera its recorded frames, each as the serialised messages that a camera sends."""
    found = []
    for camera in site.cameras:
        of_parts = {
            part: [m.raw for m in reader.messages([camera_topic(site.name, camera, topic)])]
            for part, topic in SENT.items()
        }
        found.append([dict(zip(of_parts, whole, strict=True)) for whole in zip(*of_parts.values(), strict=True)])
    return found
