"""A network file that is not what its manifest states: its node says what was expected and found, the rest goes on."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenes.networks import write_classifier
from scenes.small_site import SmallSite, apart
from scenes.waiting import wait_for

from ltm_ros.launching.graph import Graph, describe
from ltm_ros.launching.runner import Runner
from ltm_ros.launching.supervisor import RestartPolicy

pytestmark = pytest.mark.graph


def test_a_changed_network_file_costs_its_node_alone(small_site: SmallSite, ros_domain: int, tmp_path: Path) -> None:
    manifest = write_classifier(tmp_path)
    file = next(tmp_path.glob("*.onnx"))
    file.write_bytes(file.read_bytes() + b"\0")
    parameters = {"segmentation": {"model": str(manifest)}}
    whole = describe(apart(small_site.site), small_site.path, cameras=("tower",), parameters=parameters)
    graph = Graph(whole.site, (whole.node("tower/segmentation"), whole.node("tower/depth")))
    lines: list[str] = []
    policy = RestartPolicy(initial_s=0.1, maximum_s=0.4, config_tries=2)
    with Runner(
        graph, log_folder=tmp_path / "log", domain_id=ros_domain, console=lines.append, policy=policy
    ) as runner:
        wait_for(lambda: runner.given_up, "the verdict", lambda: "\n".join(lines), patience_s=180.0)
        assert runner.given_up == ["tower/segmentation"]
        assert runner.processes["tower/depth"].running
    (verdict,) = [line for line in lines if "given up" in line]
    assert "sha256" in verdict
    assert file.name in verdict
