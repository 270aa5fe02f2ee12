"""`ltm run`: what it makes of its options."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from scenes.small_site import write_small_site
from typer.testing import CliRunner

import ltm_ros.launching.runner
from ltm_ros.cli.main import cli


def test_state_is_the_folder_of_the_nodes_that_keep_something(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    graphs: list[Any] = []

    class Recorded:
        def __init__(self, graph: Any, log_folder: Path, domain_id: int | None) -> None:
            graphs.append(graph)
            self.log_folder = log_folder

        def run(self) -> int:
            return 0

    monkeypatch.setattr(ltm_ros.launching.runner, "Runner", Recorded)
    site = write_small_site(tmp_path).path
    arguments = ["run", str(site), "--logs", str(tmp_path / "logs")]
    assert CliRunner().invoke(cli, arguments).exit_code == 0
    assert CliRunner().invoke(cli, [*arguments, "--state", str(tmp_path / "deep/map")]).exit_code == 0
    without, kept = (graph.node("fuel_map").parameters for graph in graphs)
    assert "folder" not in without
    assert kept["folder"] == str(tmp_path / "deep/map")
    assert (tmp_path / "deep/map").is_dir()
