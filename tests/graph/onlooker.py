"""Somebody on the network, on its own transport profile: `python onlooker.py NAME`.

Publishes `/NAME`, and answers every line of its input with what it sees: a line of JSON.
"""

import json
import sys
import threading
from queue import Empty, Queue

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String


def main(name: str) -> None:
    rclpy.init()
    node = Node(name, enable_rosout=False)
    node.create_publisher(String, f"/{name}", 10)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    lines: Queue[str] = Queue()

    def read() -> None:
        for line in sys.stdin:
            lines.put(line)
        lines.put("")  # the test has gone

    threading.Thread(target=read, daemon=True).start()
    while True:
        executor.spin_once(timeout_sec=0.05)
        try:
            if not lines.get_nowait():
                break
        except Empty:
            continue
        seen = {
            "topics": [topic for topic, _ in node.get_topic_names_and_types()],
            "services": [service for service, _ in node.get_service_names_and_types()],
            "nodes": [f"{space.rstrip('/')}/{other}" for other, space in node.get_node_names_and_namespaces()],
        }
        print(json.dumps(seen), flush=True)
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main(sys.argv[1])
