"""`ltm-lab bench votes`: what it measures is what a frame of that size gives, and its message keeps its bound."""

from __future__ import annotations

import json
from pathlib import Path

from typer.testing import CliRunner

from ltm_core.fuel.vote_columns import MAX_BYTES
from ltm_lab.bench.votes import VIEWS
from ltm_lab.cli.main import cli


def test_every_view_is_measured_and_its_message_fits(tmp_path: Path) -> None:
    arguments = ["--width", "320", "--height", "180", "--repeats", "1", "--extent", "2500", "--cell", "5"]
    out = tmp_path / "votes.json"
    result = CliRunner().invoke(cli, ["bench", "votes", *arguments, "--json", str(out)], env={"COLUMNS": "160"})
    assert result.exit_code == 0, result.output
    report = json.loads(out.read_text())
    assert [view["view"] for view in report["views"]] == [view.name for view in VIEWS]
    for view in report["views"]:
        assert 0 < view["sent"] <= view["cells"]
        assert 0 < view["bytes"] < MAX_BYTES
        assert view["cpu_ms"] > 0
        assert 0 < view["ground"] <= 1
    assert max(view["ground"] for view in report["views"]) > 0.3
    assert max(view["cells"] for view in report["views"]) > max(view["sent"] for view in report["views"])
    assert "load average" in result.output
