"""The fuel map on a small disk of its own: `unshare -m python disk_process.py CASE SITE MOUNT_POINT`.

Mounts a file system of a megabyte that only this process sees, and says what came of it as JSON.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from ltm_core.errors import LtmError
from ltm_ros.fuel_map import persistence
from ltm_ros.nodes.fuel_map import FuelMap, FuelMapConfig
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE
from scenes.fuel_frames import camera_of, grid_of, message
from scenes.outlets import Kept

FRAMES = 30


def mount(folder: Path, *options: str) -> None:
    subprocess.run(["mount", *options, str(folder)], check=True, capture_output=True)


class Node:
    def __init__(self, site: Path, folder: Path) -> None:
        self.outlet, self.health = Kept(), Health()
        self.grid = grid_of(site)
        self.handler = FuelMap(FuelMapConfig(site=str(site), folder=str(folder)), self.outlet, self.health)
        self.handler.start()

    def feed(self, first: int, end: int) -> None:
        for number in range(first, end):
            self.handler.on_votes(camera_of(number), message(number, self.grid))
            self.handler.tick(0.5)

    def state(self) -> dict[str, object]:
        summary = self.health.summary()
        return {
            "frames": int(summary.get("frames", 0)),
            "unsaved": int(summary.get("unsaved_frames", 0)),
            "updates": len(self.outlet.on(FUEL_MAP_UPDATE)),
            "error": summary["last_error"],
            "troubled": self.health.troubled,
        }


def full(site: Path, disk: Path) -> list[dict[str, object]]:
    """The disk fills up, and later has room again."""
    mount(disk, "-t", "tmpfs", "-o", "size=2m", "tmpfs")
    node = Node(site, disk)
    node.feed(0, 3)
    states = [node.state()]
    ballast = disk / "ballast"
    room = os.statvfs(disk)
    ballast.write_bytes(bytes(room.f_bavail * room.f_bsize))
    node.feed(3, FRAMES)
    states.append(node.state())
    ballast.unlink()
    node.handler.tick(persistence.RETRY_S)
    states.append(node.state())
    node.handler.persistence.store.close()  # killed
    states.append(Node(site, disk).state())
    return states


def full_from_the_start(site: Path, disk: Path) -> list[dict[str, object]]:
    """There is no room for a store when the node starts."""
    mount(disk, "-t", "tmpfs", "-o", "size=1m", "tmpfs")
    ballast = disk / "ballast"
    ballast.write_bytes(bytes(os.statvfs(disk).f_bavail * os.statvfs(disk).f_bsize))
    node = Node(site, disk)
    node.feed(0, 3)
    node.handler.tick(persistence.RETRY_S)  # still full: said again, however long the frames took
    states = [node.state()]
    ballast.unlink()
    node.handler.tick(persistence.RETRY_S)
    return [*states, node.state()]


def read_only(site: Path, disk: Path) -> list[dict[str, object]]:
    """The disk turns read-only, as one with errors does, and is mended; another node is started meanwhile."""
    mount(disk, "-t", "tmpfs", "-o", "size=4m", "tmpfs")
    node = Node(site, disk)
    node.feed(0, 3)
    node.handler.finish()
    states = [node.state()]
    mount(disk, "-o", "remount,ro")
    node = Node(site, disk)
    node.feed(3, 6)
    states.append(node.state())
    mount(disk, "-o", "remount,rw")
    node.handler.tick(persistence.RETRY_S)
    return [*states, node.state()]


if __name__ == "__main__":
    case, site_file, mount_point = sys.argv[1:]
    try:
        subprocess.run(["mount", "--make-rprivate", "/"], check=True, capture_output=True)
        mount(Path(mount_point), "-t", "tmpfs", "-o", "size=4k", "tmpfs")
    except (OSError, subprocess.CalledProcessError) as error:
        print(json.dumps({"no mounts here": str(error)}))
        sys.exit()
    try:
        print(json.dumps({"states": globals()[case](Path(site_file), Path(mount_point))}))
    except LtmError as error:
        print(json.dumps({"refused": str(error)}))
