"""A tower's outbox on a small disk of its own: `unshare -m python outbox_disk_process.py CASE MOUNT_POINT FOLDER`."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from ltm_core.base.errors import StoreError
from ltm_core.uplink.config import UplinkConfig
from ltm_core.uplink.outbox_io import OutboxFrame
from ltm_ros.region.tower_link import OPEN_S, TowerLink
from ltm_ros.runtime.health import Health
from scenes.own_disk import answer, fill, make_disk, mount
from scenes.region_scene import CAMERA, REGION, RegionScene, stamp_of, write_region_scene

SIZE = 30_000


class Tower:
    """Its link is down: the broker's port is nobody's. Turns are taken by hand, at times that the case says."""

    def __init__(self, folder: Path, disk: Path) -> None:
        scene = RegionScene(folder) if (folder / "region.yaml").exists() else write_region_scene(folder)
        config = UplinkConfig(name=REGION, tower="alta", broker=scene.broker("alta"))
        self.file, self.health = disk / "outbox.sqlite", Health()
        self.link = TowerLink(config, scene.grid, self.file, self.health, lambda: None)

    def offer(self, first: int, end: int, now_s: float = 0.0) -> None:
        for number in range(first, end):
            self.link.offer(OutboxFrame(CAMERA, stamp_of(number), 0, "", bytes([number]) * SIZE))
        self.step(now_s)

    def step(self, now_s: float) -> None:
        try:
            self.link.step(now_s)
        except StoreError as error:  # as the link's own thread does
            self.health.trouble("store", str(error))

    def close(self) -> None:
        """Its thread was never started."""
        self.link.close()

    def state(self) -> dict[str, object]:
        return {
            "kept": self.link.kept,
            "frames": numbers_in(self.file),
            "error": self.health.last_error,
            "troubled": self.health.troubled,
            "dropped": self.health.dropped,
        }


def numbers_in(file: Path) -> list[int]:
    """Whole frames that another process finds in the file."""
    if not file.exists():
        return []
    # A reader needs a file of its own beside one that is written, which such a disk may not give it.
    how = "mode=ro" if file.with_name(f"{file.name}-wal").exists() else "immutable=1"
    with closing(sqlite3.connect(f"{file.as_uri()}?{how}", uri=True)) as db:
        try:
            rows = db.execute("SELECT stamp_ns, message FROM frames ORDER BY stamp_ns").fetchall()
        except sqlite3.OperationalError as error:
            if "no such table" in str(error):  # made, and not yet filled
                return []
            raise
    numbers = [(stamp - stamp_of(0)) // 10**9 for stamp, _ in rows]
    assert [message for _, message in rows] == [bytes([number]) * SIZE for number in numbers]
    return numbers


def full(disk: Path, folder: Path) -> list[dict[str, object]]:
    """The disk fills up, and later has room again."""
    make_disk(disk, "4m")
    tower = Tower(folder, disk)
    tower.offer(0, 3)
    states = [tower.state()]
    ballast = fill(disk)
    for number in range(3, 40):
        tower.offer(number, number + 1)
    states.append(tower.state())
    ballast.unlink()
    tower.step(1.0)
    return [*states, tower.state()]


def read_only(disk: Path, folder: Path) -> list[dict[str, object]]:
    """The tower starts on a disk that has turned read-only, and is mended."""
    make_disk(disk, "4m")
    tower = Tower(folder, disk)
    tower.offer(0, 3)
    tower.close()
    mount(disk, "-o", "remount,ro")
    tower = Tower(folder, disk)
    tower.offer(3, 6)
    states = [tower.state()]
    mount(disk, "-o", "remount,rw")
    tower.offer(6, 7, OPEN_S + 1)
    return [*states, tower.state()]


if __name__ == "__main__":
    answer({case.__name__: case for case in (full, read_only)})
