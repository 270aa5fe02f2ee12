"""Write the site of the graph benchmark: cameras that send the frames of the demo's towers."""

import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import yaml

from ltm_core.raster.dem import Dem
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_msgs_py.bag.reader import BagReader
from ltm_ros.runtime.topics import CAMERA_INFO, IMAGE_COMPRESSED, POSE, camera_topic

Layout = Literal["site", "node"]
NAME = "bench"
SENT = {"info": CAMERA_INFO, "pose": POSE, "image": IMAGE_COMPRESSED}
"""The topics of a camera in the order of sending; the names are the suffixes of the frames' files."""


def stamped(cdr: bytes, stamp_ns: int) -> bytes:
    """Return a serialised stamped message with another stamp: sec and nanosec follow the 4-byte encapsulation."""
    order = "<" if cdr[1] & 1 else ">"
    return cdr[:4] + struct.pack(f"{order}iI", *divmod(stamp_ns, 10**9)) + cdr[12:]


@dataclass(frozen=True)
class Load:
    """The site of a run.

    `fusion`: the site has a depth network. `processes`: layout as in a site file, or None for its default. `patrol`:
    cameras turn like the demo's towers; otherwise each sends the same view again. `dem_size`: cells per side to which
    the demo's DEM is resampled, or None for the DEM itself.
    """

    cameras: int
    fusion: bool = True
    processes: Layout | None = None
    patrol: bool = True
    dem_size: int | None = None


@dataclass(frozen=True)
class Traffic:
    """A site file, its cameras, and the number of different frames in each camera's folder."""

    site: Path
    cameras: tuple[str, ...]
    frames: int


def write_site(folder: Path, demo: Path, load: Load) -> Traffic:
    """Write a site file and serialised frames `<number>.<part>.cdr` into `folder`.

    Camera i has the frames of tower i modulo the number of towers; cameras of the same tower start at different frames.
    """
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
    content |= {} if load.processes is None else {"expert": {"processes": load.processes}}
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    towers = _frames_of(original, BagReader(demo / "recording"))
    for number, name in enumerate(names):
        frames = towers[number % len(towers)]
        first = number // len(towers)
        (folder / name).mkdir()
        for at in range(len(frames) if load.patrol else 1):
            for part, cdr in frames[(at + first) % len(frames)].items():
                (folder / name / f"{at:03d}.{part}.cdr").write_bytes(cdr)
    return Traffic(path, names, min(map(len, towers)) if load.patrol else 1)


def _dem(folder: Path, demo: Path, size: int | None) -> Path:
    """Return the path of the demo's DEM, or of the same terrain resampled to `size` x `size` cells."""
    if size is None:
        return demo
    dem = Dem.open(demo)
    place = dem.geometry
    heights = cv2.resize(dem.elevation, (size, size), interpolation=cv2.INTER_LINEAR)
    finer = replace(place, resolution=place.resolution * place.width / size, width=size, height=size)
    Dem(np.asarray(heights, np.float32), finer).save(folder / "dem.tif")
    return folder / "dem.tif"


def _frames_of(site: Site, reader: BagReader) -> list[list[dict[str, bytes]]]:
    """Return the recorded frames of each camera as the serialised messages that a camera sends."""
    found = []
    for camera in site.cameras:
        of_parts = {
            part: [m.raw for m in reader.messages([camera_topic(site.name, camera, topic)])]
            for part, topic in SENT.items()
        }
        found.append([dict(zip(of_parts, whole, strict=True)) for whole in zip(*of_parts.values(), strict=True)])
    return found
