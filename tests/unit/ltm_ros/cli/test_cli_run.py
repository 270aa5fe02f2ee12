from pathlib import Path
from typing import Any

import pytest
from scenes.small_site import write_small_site
from typer.testing import CliRunner

import ltm_ros.launching.runner
import ltm_ros.launching.site_check
from ltm_ros.cli.main import cli


def test_state_is_the_folder_of_the_nodes_that_keep_something(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    graphs: list[Any] = []

    class Recorded:
        def __init__(self, graph: Any, domain_id: int | None) -> None:
            graphs.append(graph)

        def run(self, manager: Any) -> int:
            return 0

    monkeypatch.setattr(ltm_ros.launching.runner, "Runner", Recorded)
    monkeypatch.setattr(ltm_ros.launching.site_check, "examined_apart", lambda path, wanted, folders: [])
    site = write_small_site(tmp_path).path
    arguments = ["run", str(site)]
    assert CliRunner().invoke(cli, arguments).exit_code == 0
    assert CliRunner().invoke(cli, [*arguments, "--state", str(tmp_path / "deep/map")]).exit_code == 0
    without, kept = (graph.node("fuel_map").parameters for graph in graphs)
    assert "folder" not in without
    assert kept["folder"] == str(tmp_path / "deep/map")
    assert (tmp_path / "deep/map").is_dir()


def test_a_site_that_cannot_work_ends_before_any_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the check in a process of its own, as a user has it."""
    monkeypatch.setattr(ltm_ros.launching.runner, "Runner", None)
    site = write_small_site(tmp_path, recording=False).path
    site.write_text(site.read_text().replace("EPSG:26911", "EPSG:26910").replace("colors.yaml", "colours.yaml"))
    ended = CliRunner().invoke(cli, ["run", str(site), "--state", str(tmp_path / "map")], env={"COLUMNS": "400"})
    assert ended.exit_code == 78
    lines = ended.stderr.splitlines()
    assert [line.partition(": ")[2].partition(":")[0] for line in lines] == ["terrain, dem", "networks, model"]
    assert "gdalwarp" in lines[0]
    assert not (tmp_path / "map").exists()
