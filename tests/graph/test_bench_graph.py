"""`ltm-lab bench graph`: the real graph finishes the frames of its simulated cameras."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from ltm_lab.cli.bench.graph import graph

pytestmark = [pytest.mark.graph, pytest.mark.slow, pytest.mark.usefixtures("kernels")]


def test_all_frames_are_finished_or_counted(
    ros_domain: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = tmp_path / "new" / "graph.json"
    graph(cameras="1", rates="1", seconds=4.0, fusion=False, domain=ros_domain, json_path=report)
    (run,) = json.loads(report.read_text())["runs"]
    assert (run["cameras"], run["offered"], run["lost"], run["unlabelled"]) == (1, 4, 0, 0)
    assert run["finished"] == run["admitted"] == run["voted"] == run["stored"] >= 2
    assert 0 < run["latency_p50_s"] <= run["latency_p95_s"] <= run["latency_p99_s"]
    assert run["cpu_ms_a_frame"]["all"] > run["cpu_ms_a_frame"]["segmentation"] > 0
    assert "topodepth" not in run["cpu_ms_a_frame"]
    assert "the demo's frames, without fusion" in capsys.readouterr().out
