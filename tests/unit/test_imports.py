"""Imports run one way: ltm_ros -> ltm_msgs_py -> ltm_core, and ltm_core knows no ROS. Read from the sources, so that
imports inside functions count too."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
ROS = {
    "rclpy", "rpyutils", "rosidl_runtime_py", "rosidl_parser", "ament_index_python", "launch", "launch_ros",
    "rosbag2_py", "sensor_msgs", "geometry_msgs", "nav_msgs", "std_msgs", "std_srvs", "diagnostic_msgs",
    "builtin_interfaces", "rosgraph_msgs", "rcl_interfaces", "cv_bridge", "tf2_ros", "rosbags", "mcap_ros2",
}  # fmt: skip
BY_NAME = {"import_module", "importlib.import_module", "__import__"}


def imported(source: str, package: str) -> Iterator[str]:
    """Top-level names of all modules that a source imports; `package`: what a relative import starts from."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield (node.module or "").partition(".")[0] if node.level == 0 else package
        elif isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in (
            "import_module",
            "__import__",
        ):
            yield from (a.value.partition(".")[0] for a in node.args if isinstance(a, ast.Constant))


@pytest.mark.parametrize(
    ("package", "forbidden"),
    [("ltm_core", ROS | {"ltm_msgs_py", "ltm_ros"}), ("ltm_msgs_py", {"ltm_ros"})],
)
def test_nothing_imports_upwards(package: str, forbidden: set[str]) -> None:
    files = sorted((REPOSITORY / package).rglob("*.py"))
    assert len(files) > 5
    upwards = {
        f"{path.relative_to(REPOSITORY)} imports {name}"
        for path in files
        for name in imported(path.read_text(encoding="utf-8"), package)
        if name in forbidden
    }
    assert not upwards


def test_every_way_to_import_is_seen() -> None:
    source = """
import a.b, c as d
from e.f import g
from . import h
def late():
    from i import j
    import importlib
    importlib.import_module("k.l")
    __import__("m")
"""
    assert set(imported(source, "own")) == {"a", "c", "e", "own", "i", "importlib", "k", "m"}
