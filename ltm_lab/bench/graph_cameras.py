"""Process that sends the frames of the graph's load test: `python -m ltm_lab.bench.graph_cameras FOLDER CAMERA ...`.

It says `ready` when all of its cameras are listened to. Then each line of JSON at its stdin orders a stream, and is
answered by one with the stamps that were sent; the end of its stdin ends it.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import rclpy
from rclpy.node import Node

from ltm_lab.bench.graph_site import NAME, SENT, stamp_of_frame
from ltm_lab.bench.network_towers import stamped
from ltm_ros.runtime.dds_shutdown import limit_shutdown
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.topics import camera_topic

PATIENCE_S = 120.0


def main() -> None:
    folder, cameras = Path(sys.argv[1]), sys.argv[2:]
    frames = {
        camera: [
            {part: (folder / camera / f"{number:03d}.{part}.cdr").read_bytes() for part in SENT}
            for number in range(len([*(folder / camera).glob("*.image.cdr")]))
        ]
        for camera in cameras
    }
    rclpy.init()
    node = Node("cameras", enable_rosout=False)
    publishers = {
        (camera, part): node.create_publisher(topic.type, camera_topic(NAME, camera, topic), stream_qos())
        for camera in cameras
        for part, topic in SENT.items()
    }
    deadline = time.monotonic() + PATIENCE_S
    while any(publisher.get_subscription_count() < 1 for publisher in publishers.values()):
        if time.monotonic() > deadline:
            sys.exit("nobody listens to the cameras")
        time.sleep(0.05)
    print("ready", flush=True)
    for line in sys.stdin:
        order = json.loads(line)
        sent: dict[str, list[int]] = {camera: [] for camera in cameras}
        late, gap = 0.0, order["period"] / len(cameras)
        for number in range(order["frames"]):
            for index, camera in enumerate(cameras):
                due = order["begin"] + number * order["period"] + index * gap
                while (wait := due - time.time()) > 0:
                    time.sleep(wait)
                late = max(late, -wait)
                stamp = stamp_of_frame(time.time_ns(), index)
                for part, cdr in frames[camera][number % len(frames[camera])].items():
                    publishers[camera, part].publish(stamped(cdr, stamp))
                sent[camera].append(stamp)
        print(json.dumps({"sent": sent, "late": late}), flush=True)
    limit_shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
