"""A node that cannot work as it is told says why and exits with the status that keeps the graph from trying again."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from scenes.networks import write_classifier
from scenes.small_site import SmallSite

from ltm_ros.runtime.handler import EX_CONFIG

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
