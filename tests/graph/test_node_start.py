"""A node that cannot work as it is told says why and exits with the status that keeps the graph from trying again."""

from __future__ import annotations

import subprocess
import sys

import pytest
from scenes.small_site import SmallSite

from ltm_ros.runtime.handler import EX_CONFIG

pytestmark = pytest.mark.graph


def test_wrong_parameters_end_a_node_with_their_names(small_site: SmallSite, ros_domain: int) -> None:
    site = f"site:={small_site.path}"
    cases = {
        ("depth", "camera:=tower", "speed:=3", site): "speed",
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
