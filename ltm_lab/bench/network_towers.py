"""Process that sends the votes of the load test's towers: `python -m ltm_lab.bench.network_towers FOLDER`.

It is driven by lines of JSON at its stdin: the first says what to send, the second (after this process has said that
all listeners are there) when to begin. Messages are serialised once and only get a new stamp, so that many towers need
little processor time.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from pathlib import Path

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

from ltm_ros.runtime.dds_shutdown import limit_shutdown
from ltm_ros.runtime.outlet_node import stream_qos
from ltm_ros.runtime.topics import FUEL_VOTES, camera_topic

PATIENCE_S = 60.0


def stamped(cdr: bytes, stamp_ns: int) -> bytes:
    """A serialised stamped message with another stamp: sec and nanosec follow the 4-byte encapsulation."""
    order = "<" if cdr[1] & 1 else ">"
    return cdr[:4] + struct.pack(f"{order}iI", *divmod(stamp_ns, 10**9)) + cdr[12:]


def main() -> None:
    folder = Path(sys.argv[1])
    order = json.loads(sys.stdin.readline())
    messages = {name: [p.read_bytes() for p in sorted(folder.glob(f"{name}.*.cdr"))] for name in order["towers"]}
    rclpy.init()
    nodes = [Node("camera", namespace=f"/{order['site']}/{name}", enable_rosout=False) for name in messages]
    publishers = {
        name: node.create_publisher(PointCloud2, camera_topic(order["site"], name, FUEL_VOTES), stream_qos())
        for name, node in zip(messages, nodes, strict=True)
    }
    deadline = time.monotonic() + PATIENCE_S
    while any(publisher.get_subscription_count() < 1 for publisher in publishers.values()):
        if time.monotonic() > deadline:
            sys.exit("nobody listens to the towers")
        time.sleep(0.05)
    print("ready", flush=True)
    begin = json.loads(sys.stdin.readline())["begin"]
    sent, late = [], 0.0
    for number in range(order["frames"]):
        for index, (name, pool) in enumerate(messages.items()):
            due = begin + number * order["period"] + (order["first"] + index) * order["gap"]
            while (wait := due - time.time()) > 0:
                time.sleep(wait)
            late = max(late, -wait)
            # Unique over all towers, so that an update names its frame.
            stamp = time.time_ns() // 10_000 * 10_000 + order["first"] + index
            publishers[name].publish(stamped(pool[number % len(pool)], stamp))
            sent.append(stamp)
    print(json.dumps({"sent": sent, "late": late}), flush=True)
    sys.stdin.readline()  # stay until all has arrived: a writer that goes takes its history with it
    limit_shutdown()
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
