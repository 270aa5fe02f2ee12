"""The fuel map's handler as a process: `python fuel_map_process.py SITE FOLDER`, frames by their numbers at its stdin.

It says a frame's number once the frame is acknowledged, or known already, so that a test can kill it at any moment and
know what is owed to it.
"""

from __future__ import annotations

import select
import sys
from pathlib import Path
from typing import Any

from ltm_ros.fuel_map import persistence
from ltm_ros.fuel_map.services import FuelMapConfig
from ltm_ros.nodes.fuel_map import FuelMapHandler
from ltm_ros.runtime.handler import Topic
from ltm_ros.runtime.health import Health
from ltm_ros.runtime.topics import FUEL_MAP_UPDATE
from scenes.fuel_frames import BEGIN_NS, PERIOD_NS, camera_of, grid_of, message

TILES_EVERY = 7
"""Frames after which tiles are written: often, so that kills fall into it."""


class Teller:
    """Says the number of every frame that an update tells of."""

    def publish(self, topic: Topic, sent: Any) -> None:
        if topic is FUEL_MAP_UPDATE:
            stamp = sent.header.stamp
            print((stamp.sec * 10**9 + stamp.nanosec - BEGIN_NS) // PERIOD_NS, flush=True)

    def wanted(self, _: Topic) -> bool:
        return True

    def now_ns(self) -> int:
        return 0

    def acknowledge(self, topic: Topic, stamp_ns: int) -> None: ...

    def workers(self, _: Topic) -> frozenset[str]:
        return frozenset()


def main(site: Path, folder: Path) -> None:
    persistence.LOGGED_FRAMES = TILES_EVERY
    grid = grid_of(site)
    health = Health()
    handler = FuelMapHandler(FuelMapConfig(site=str(site), folder=str(folder)), Teller(), health)
    handler.start()
    print("ready", flush=True)
    for line in iter(sys.stdin.readline, ""):
        number = int(line)
        known = health.dropped.get("duplicate", 0)
        handler.on_votes(camera_of(number), message(number, grid))
        if health.dropped.get("duplicate", 0) > known:
            print(number, flush=True)
        if not select.select([sys.stdin], [], [], 0)[0]:
            handler.idle()
    handler.finish()


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
