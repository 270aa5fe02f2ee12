"""Print the middleware and shared-memory sizes of a ROS process as one line of JSON.

Only a real participant gives a reliable answer: Fast DDS ignores a profile that it cannot read.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import rclpy

from ltm_ros.launching import shared_memory
from ltm_ros.runtime.ros_environment import limit_shutdown


def own_segment_bytes() -> list[int]:
    """Return the sizes of the shared-memory segments that this process created, largest first."""
    sizes = set()
    for link in Path("/proc/self/fd").iterdir():
        try:
            lock = link.readlink()
        except OSError:
            continue
        segment = lock.with_name(lock.name.removesuffix("_el"))
        if lock.parent == shared_memory.SHM_FOLDER and lock.name.endswith("_el") and "_port" not in lock.name:
            sizes.add((segment.name, segment.stat().st_size))
    return sorted((size for _, size in sizes), reverse=True)


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("ltm_transport_probe", enable_rosout=False)
    print(json.dumps({"rmw": rclpy.get_rmw_implementation_identifier(), "segment_bytes": own_segment_bytes()}))
    sys.stdout.flush()
    limit_shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
