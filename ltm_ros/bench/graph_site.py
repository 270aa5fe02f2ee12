"""Makes the site of the graph's load test: as many cameras as asked for, with the frames of the demo's towers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import yaml

from ltm_core.site import Site
from ltm_core.site_io import load_site
from ltm_msgs_py.bag.reader import BagReader
from ltm_ros.runtime.topics import CAMERA_INFO, IMAGE_COMPRESSED, POSE, camera_topic

Layout = Literal["site", "node"]
NAME = "bench"
SENT = {"info": CAMERA_INFO, "pose": POSE, "image": IMAGE_COMPRESSED}
"""What a camera sends of each frame, in this order; the names are the suffixes of its files."""


@dataclass(frozen=True)
class Traffic:
    """`frames`: how many different ones each camera's folder holds, as `<number>.<part>.cdr`."""

    site: Path
    cameras: tuple[str, ...]
    frames: int


def write_site(folder: Path, demo: Path, cameras: int, fusion: bool = True, processes: Layout | None = None) -> Traffic:
    """Site file and serialised frames in `folder`; camera i looks as tower i modulo the number of towers, each of them
    beginning with another frame. Without `fusion` the site has no depth network. `processes`: as in a site file."""
    original = load_site(demo / "site.yaml")
    names = tuple(f"c{number:02d}" for number in range(cameras))
    content = {
        "name": NAME,
        "crs": original.crs,
        "origin": list(original.origin),
        "dem": {"path": str((demo / "dem.tif").resolve())},
        "fuel": {"prior": str((demo / "prior.tif").resolve())},
        "depth_model": original.depth_model if fusion else "",
        "cameras": {name: {} for name in names},
    } | ({} if processes is None else {"processes": processes})
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    towers = _frames_of(original, BagReader(demo / "recording"))
    for number, name in enumerate(names):
        frames = towers[number % len(towers)]
        (folder / name).mkdir()
        for at in range(len(frames)):
            for part, cdr in frames[(at + number // len(towers)) % len(frames)].items():
                (folder / name / f"{at:03d}.{part}.cdr").write_bytes(cdr)
    return Traffic(path, names, min(map(len, towers)))


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
