"""Prints how many signatures each kernel is compiled for once `locate` has started, and after marks of two cameras."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from scenes.kernel_counts import compiled
from unit.ltm_ros.nodes.test_locate_node import TOWERS, Running, region, seen_by

from ltm_ros.runtime.topics import LOCATE_REGION


def main() -> None:
    running = Running(Path(sys.argv[1]))
    running.node.start()
    before = compiled()
    for turned_deg in (0.0, 2.0):
        for camera in TOWERS:
            seen = seen_by(camera, turned_deg if camera == "east" else 0.0)
            running.pose(seen)
            running.send(camera, LOCATE_REGION, region(seen))
    print(json.dumps([before, compiled()]))


if __name__ == "__main__":
    main()
