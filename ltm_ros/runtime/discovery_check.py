"""Checks whether the publishers and subscribers of a graph are matched; messages sent before that are lost silently."""

from __future__ import annotations

from collections.abc import Mapping

from rclpy.node import Node

LISTENERS = "listeners."
"""Prefix of the diagnostics key that holds how many subscribers a node's publisher is matched with."""


def unmatched(node: Node, summaries: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Topics that have more subscribers than their publisher is matched with, or the other way round.

    DDS discovers each pair of processes by itself: that `node` knows of two others says nothing of what these know of
    each other. So their own word counts, `summaries`: the latest diagnostics of every node, by full name. Listeners
    that are none of these, somebody's `ros2 topic echo`, are waited for by nobody.
    """
    found = []
    for name, summary in summaries.items():
        namespace = name.rpartition("/")[0]
        for key, value in summary.items():
            if key.startswith(LISTENERS):
                topic = key.removeprefix(LISTENERS)
                topic = topic if topic.startswith("/") else f"{namespace}/{topic}"
                listeners = [
                    f"{end.node_namespace.rstrip('/')}/{end.node_name}"
                    for end in node.get_subscriptions_info_by_topic(topic)
                ]
                # One whose name is not yet known may be anybody's.
                ours = sum(listener in summaries or "_UNKNOWN_" in listener for listener in listeners)
                matched = int(value)
                if matched < ours or (matched != ours and ours == len(listeners)):
                    found.append(topic)
    return found


def unheard(node: Node) -> dict[str, str]:
    """Topics of a node's own subscriptions that more publish on than it is matched with: what is wrong, with a remedy.

    For a moment after somebody comes or goes that is as it should be.
    """
    found = {}
    for subscription in node.subscriptions:
        topic = subscription.topic_name
        known, matched = node.count_publishers(topic), subscription.get_publisher_count()
        if matched < known:
            found[topic] = (
                f"{known} publish {topic}, {matched} reach this node; let them offer what it asks for (reliable, and "
                "transient local where it is latched), or restart it"
            )
    return found
