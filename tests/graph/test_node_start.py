"""A node that cannot work as it is told says why and exits with the status that tells the graph not to try again."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from bystander import Bystander
from rclpy.qos import QoSProfile, ReliabilityPolicy
from scenes.networks import write_classifier
from scenes.small_site import NAME, SmallSite, apart
from scenes.waiting import wait_for

from ltm_ros.launching.graph import Graph, describe, parameters_yaml
from ltm_ros.launching.runner import Runner
from ltm_ros.runtime.handler import EX_CONFIG
from ltm_ros.runtime.topics import IMAGE_RAW, camera_topic

pytestmark = pytest.mark.graph


def test_what_a_node_cannot_work_with_ends_it_with_its_name(
    small_site: SmallSite, ros_domain: int, tmp_path: Path
) -> None:
    site, manifest = f"site:={small_site.path}", write_classifier(tmp_path)
    network = next(tmp_path.glob("*.onnx"))
    network.write_bytes(network.read_bytes() + b"\0")
    cases = {
        ("depth", "camera:=tower", "speed:=3", site): "speed",
        ("segmentation", "camera:=tower", f"model:={manifest}", site): "sha256",
        ("fuel_map", "site:=/nowhere/site.yaml"): "/nowhere/site.yaml",
        ("recorder", "bag:=/nowhere/bag", "topics:=['no topic']", site): "'no topic'",
    }
    started = {
        case: subprocess.Popen(
            [sys.executable, "-m", f"ltm_ros.nodes.{case[0]}", "--ros-args", *_given(case[1:])],
            stderr=subprocess.PIPE,
            text=True,
        )
        for case in cases
    }
    for case, named in cases.items():
        _, errors = started[case].communicate(timeout=120)
        assert started[case].returncode == EX_CONFIG, (case, errors)
        reasons = [line for line in errors.splitlines() if line.startswith(f"{case[0]}: cannot start: ")]
        assert reasons, (case, errors)
        assert named in errors, (case, errors)
        assert "Traceback" not in errors, (case, errors)


def _given(parameters: tuple[str, ...]) -> list[str]:
    return [part for parameter in parameters for part in ("-p", parameter)]


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


CAPTURE = f"/{NAME}/mast/capture"
IMAGES = camera_topic(NAME, "mast", IMAGE_RAW)


def test_a_publisher_that_cannot_be_heard_is_told_of(small_site: SmallSite, ros_domain: int, tmp_path: Path) -> None:
    """A driver that offers best effort, where the node asks for a reliable one."""
    node = describe(apart(small_site.site), small_site.path).node("mast/capture")
    offered = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    with Runner(Graph(NAME, (node,)), domain_id=ros_domain), Bystander() as bystander:
        bystander.node.create_publisher(IMAGE_RAW.type, IMAGES, offered)

        def error() -> str:
            return bystander.summaries.get(CAPTURE, {}).get("last_error", "")

        wait_for(lambda: f"{IMAGES}: this node is matched with 0 of 1" in error(), "word of the publisher", error)
