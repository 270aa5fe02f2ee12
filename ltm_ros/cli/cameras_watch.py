"""`ltm cameras watch`: what the diagnostics of a running graph say of its cameras."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rich.markup import escape
from rich.table import Table

from ltm_ros.launching.dds_shutdown import limit_shutdown

STYLES = {"alive": "green", "connecting": "cyan", "night": "blue", "moved": "cyan"}
"""Of the states that need nobody; the others are red."""
SILENT_S = 5.0
"""Diagnostics come once a second."""


class CameraWatch:
    """Listens to `/diagnostics` in a context of its own."""

    def __init__(self, site: str, cameras: Sequence[str]) -> None:
        self._names = {f"/{site}/{camera}/source": camera for camera in cameras}
        self._said: dict[str, tuple[float, dict[str, str]]] = {}
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = Node("ltm_cameras_watch", context=self._context, enable_rosout=False)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 50)

    def listen(self, seconds: float, until_all: bool = False) -> None:
        """For so long, or until every camera was heard of."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline and not (until_all and not self.silent()):
            self._executor.spin_once(timeout_sec=0.1)

    def states(self) -> dict[str, dict[str, str]]:
        """What was said last, by camera; empty of one that is silent."""
        now = time.monotonic()
        found: dict[str, dict[str, str]] = {}
        for camera in self._names.values():
            at, said = self._said.get(camera, (0.0, {}))
            found[camera] = said if now - at < SILENT_S else {}
        return found

    def silent(self) -> list[str]:
        """Cameras of which nothing was ever heard."""
        return [camera for camera in self._names.values() if camera not in self._said]

    def close(self) -> None:
        limit_shutdown()
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def _on_diagnostics(self, message: Any) -> None:
        for status in message.status:
            camera = self._names.get(status.name)
            if camera is not None:
                self._said[camera] = time.monotonic(), {value.key: value.value for value in status.values}


def state_table(states: Mapping[str, Mapping[str, str]]) -> Table:
    """A row a camera."""
    table = Table("camera", "state", "since", "picture", "stamps", "clock", "published", "refused", "why")
    for camera, said in states.items():
        if not said:
            table.add_row(camera, "[red]silent", "", "", "", "", "", "", "its node says nothing: does the graph run?")
            continue
        state = said.get("state", "?")
        age, known = said.get("picture_age_s"), said.get("stamp_uncertainty_s")
        ahead = said.get("camera_clock_ahead_s")
        table.add_row(
            camera,
            f"[{STYLES.get(state, 'bold red')}]{escape(state)}",
            _since(said.get("state_since")),
            "" if age is None else f"{age} s ago",
            "" if known is None else f"+- {known} s by {escape(said.get('stamp_told_by', '?'))}",
            "" if ahead is None else f"{float(ahead):+.1f} s",
            said.get("frames_out", ""),
            said.get("dropped", ""),
            escape(said.get("state_why", "")),
        )
    return table


def _since(epoch: str | None) -> str:
    if not epoch:
        return ""
    return datetime.fromtimestamp(float(epoch)).strftime("%m-%d %H:%M:%S")
