"""One end of an image stream, as a process: `python image_stream.py publish|subscribe TOPIC FRAMES [RATE]`.

Images are 1080p rgb8; each carries its number in the stamp and, as content, a byte that follows from the number. The
subscriber prints the numbers that it received, in order, with a `!` after those whose content is wrong.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import rclpy
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from std_msgs.msg import Empty

from ltm_ros.runtime.ros_environment import wait_for_quiet

HEIGHT, WIDTH = 1080, 1920
QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
SUBSCRIBERS = 3
PATIENCE_S = 20.0


def matched(topic: str) -> str:
    """A topic that each subscriber opens once it has found the publisher; nothing is sent on it."""
    return f"{topic}/matched"


def content(number: int) -> int:
    return (7 * number + 3) % 256


def publish(node: Any, topic: str, frames: int, rate: float) -> None:
    publisher = node.create_publisher(Image, topic, QOS)
    deadline = time.monotonic() + PATIENCE_S
    # The subscribers' side of a match may still be under way when this side's is done: their own word is waited for.
    while min(counts := (publisher.get_subscription_count(), node.count_publishers(matched(topic)))) < SUBSCRIBERS:
        assert time.monotonic() < deadline, f"of {SUBSCRIBERS} subscribers came, and said so: {counts}"
        time.sleep(0.02)
    message = Image(height=HEIGHT, width=WIDTH, encoding="rgb8", step=3 * WIDTH)
    start = time.monotonic()
    for number in range(frames):
        message.header.stamp.sec = number
        message.data = bytes([content(number)]) * (HEIGHT * WIDTH * 3)
        publisher.publish(message)
        time.sleep(max(0.0, start + (number + 1) / rate - time.monotonic()))  # the stream's pace
    # A writer that goes takes what a slow reader still lacks with it.
    while publisher.get_subscription_count() > 0 and time.monotonic() < start + frames / rate + PATIENCE_S:
        time.sleep(0.05)


def subscribe(node: Any, topic: str, frames: int) -> None:
    received: list[str] = []
    last = [0.0]

    def take(message: Any) -> None:
        number = message.header.stamp.sec
        right = len(message.data) == HEIGHT * WIDTH * 3 and {*message.data[:: HEIGHT * 8]} == {content(number)}
        received.append(f"{number}" if right else f"{number}!")
        last[0] = time.monotonic()

    found: list[Any] = []
    events = SubscriptionEventCallbacks(matched=found.append)
    node.create_subscription(Image, topic, take, QOS, event_callbacks=events)
    print("ready", flush=True)
    deadline = time.monotonic() + PATIENCE_S
    while not found and time.monotonic() < deadline:
        rclpy.spin_once(node, timeout_sec=0.2)
    node.create_publisher(Empty, matched(topic), 1)
    while len(received) < frames and time.monotonic() < (last[0] + PATIENCE_S / 2 if received else deadline):
        rclpy.spin_once(node, timeout_sec=0.2)
    print(" ".join(received), flush=True)


def main() -> None:
    role, topic, frames = sys.argv[1], sys.argv[2], int(sys.argv[3])
    rclpy.init()
    node = rclpy.create_node(role)
    if role == "publish":
        publish(node, topic, frames, float(sys.argv[4]))
    else:
        subscribe(node, topic, frames)
    wait_for_quiet(node)
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
