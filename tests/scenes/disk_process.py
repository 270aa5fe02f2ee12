"""The fuel map on a small disk of its own: `unshare -m python disk_process.py CASE MOUNT_POINT SITE`."""

from pathlib import Path

from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.runtime import retry
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE
from scenes.fuel_frames import camera_of, grid_of, message
from scenes.outlets import Kept
from scenes.own_disk import answer, fill, make_disk

FRAMES = 30
MANY = 150


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


if __name__ == "__main__":
    cases = (full, stopped_while_full, full_from_the_start)
    answer({case.__name__: case for case in cases})
