"""Parameters reach a real node through the file that the runner writes, each with its type."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from ltm_ros.launching.graph import parameters_yaml

pytestmark = pytest.mark.graph

ECHO = """
import json, rclpy
rclpy.init()
node = rclpy.create_node("echo", automatically_declare_parameters_from_overrides=True)
values = {name: p.value for name, p in node.get_parameters_by_prefix("").items()}
values = {n: v if isinstance(v, (bool, int, float, str)) else list(v) for n, v in values.items()}
print(json.dumps({n: [type(v).__name__, v] for n, v in values.items()}))
node.destroy_node()
rclpy.try_shutdown()
"""


def test_ros_reads_what_was_meant(ros_domain: int, tmp_path: Path) -> None:
    values: dict[str, Any] = {
        "flag": True,
        "count": 2**53 + 1,
        "small": 1e-05,
        "large": 1e20,
        "whole": 2.0,
        "word": "on",
        "letter": "y",
        "number": "12",
        "text": "a: 'b' \"c\" # \\ é\nnext",
        "empty": "",
        "numbers": [1.0, 2.5e-07],
        "words": ["n", "1"],
        "flags": [True, False],
        "nested.counts": [1, -2],
    }
    path = tmp_path / "node.yaml"
    path.write_text(parameters_yaml(values), encoding="utf-8")
    command = [sys.executable, "-c", ECHO, "--ros-args", "--params-file", str(path)]
    read = json.loads(subprocess.check_output(command, text=True, timeout=60).splitlines()[-1])
    assert {name: read[name] for name in values} == {n: [type(v).__name__, v] for n, v in values.items()}
