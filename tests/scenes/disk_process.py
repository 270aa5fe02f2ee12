"""The fuel map on a small disk of its own: `unshare -m python disk_process.py CASE MOUNT_POINT SITE`."""

from __future__ import annotations

from pathlib import Path

from ltm_core.base.errors import StoreError
from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.runtime import retry
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE
from scenes.fuel_frames import camera_of, grid_of, message
from scenes.outlets import Kept
from scenes.own_disk import answer, fill, make_disk, mount, take_inodes

FRAMES = 30
MANY = 150
SLOW_FRAMES = 30


class Node:
    def __init__(self, site: Path, folder: Path) -> None:
        self.outlet, self.health = Kept(), Health()
        self.grid = grid_of(site)
        self.handler = FuelMapHandler(FuelMapConfig(site=str(site), folder=str(folder)), self.outlet, self.health)
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


def full(disk: Path, site: Path) -> list[dict[str, object]]:
    """The disk fills up, and later has room again."""
    make_disk(disk, "2m")
    node = Node(site, disk)
    node.feed(0, 3)
    states = [node.state()]
    ballast = fill(disk)
    node.feed(3, 6)
    states.append(node.state())
    node.feed(6, FRAMES)
    states.append(node.state())
    ballast.unlink()
    node.handler.tick(retry.LONGEST_RETRY_S)
    states.append(node.state())
    node.handler.persistence.store.close()  # killed
    states.append(Node(site, disk).state())
    return states


def stopped_while_full(disk: Path, site: Path) -> list[dict[str, object]]:
    """The node is told to stop on a disk that has had no room for long."""
    make_disk(disk, "8m")
    node = Node(site, disk)
    node.feed(0, 3)
    fill(disk)
    node.feed(3, MANY)
    states = [node.state()]
    node.handler.finish()
    states.append(node.state())
    states.append(Node(site, disk).state())
    return states


def lost(disk: Path, site: Path) -> list[dict[str, object]]:
    """The same where somebody has taken the room that the store held, too."""
    make_disk(disk, "4m")
    node = Node(site, disk)
    node.feed(0, 3)
    for held in disk.glob(".*.reserve"):
        held.unlink()
    fill(disk)
    node.feed(3, FRAMES)
    try:
        node.handler.finish()
        said = ""
    except StoreError as error:
        said = str(error)
    states = [node.state() | {"said": said}]
    states.append(Node(site, disk).state())
    return states


def full_from_the_start(disk: Path, site: Path) -> list[dict[str, object]]:
    """There is no room for a store when the node starts."""
    make_disk(disk, "1m")
    ballast = fill(disk)
    node = Node(site, disk)
    node.feed(0, 3)
    node.handler.tick(retry.LONGEST_RETRY_S)  # still full: said again, however long the frames took
    states = [node.state()]
    ballast.unlink()
    node.handler.tick(retry.LONGEST_RETRY_S)
    return [*states, node.state()]


def read_only(disk: Path, site: Path) -> list[dict[str, object]]:
    """The disk turns read-only, as one with errors does, and is mended; another node is started meanwhile."""
    make_disk(disk, "4m")
    node = Node(site, disk)
    node.feed(0, 3)
    node.handler.finish()
    states = [node.state()]
    mount(disk, "-o", "remount,ro")
    node = Node(site, disk)
    node.feed(3, 6)
    states.append(node.state())
    mount(disk, "-o", "remount,rw")
    node.handler.tick(retry.LONGEST_RETRY_S)
    return [*states, node.state()]


def no_inodes(disk: Path, site: Path) -> list[dict[str, object]]:
    """There is room for bytes and none for another file, while a node runs and when one starts."""
    make_disk(disk, "8m", inodes=40)
    node = Node(site, disk)
    node.feed(0, 3)
    taken = take_inodes(disk)
    node.feed(3, 6)
    states = [node.state()]
    node.handler.finish()
    states.append(node.state())
    taken += take_inodes(disk)
    node = Node(site, disk)
    node.feed(6, 9)
    states.append(node.state())
    for file in taken:
        file.unlink()
    node.handler.tick(retry.LONGEST_RETRY_S)
    states.append(node.state())
    node.handler.persistence.store.close()  # killed
    return [*states, Node(site, disk).state()]


def slow(disk: Path, site: Path) -> list[dict[str, object]]:
    """Each fsync takes 2 s (`slow_fsync`): a disk that is about to fail, or an SD card."""
    make_disk(disk, "8m")
    node = Node(site, disk)
    for number in range(0, SLOW_FRAMES, 10):
        # Ten frames between two looks of the node at the clock: as they come while it waits for the disk.
        for frame in range(number, number + 10):
            node.handler.on_votes(camera_of(frame), message(frame, node.grid))
        node.handler.tick(0.5)
    states = [node.state()]
    node.handler.persistence.store.close()  # killed
    return [*states, Node(site, disk).state()]


if __name__ == "__main__":
    cases = (full, stopped_while_full, lost, full_from_the_start, read_only, no_inodes, slow)
    answer({case.__name__: case for case in cases})
