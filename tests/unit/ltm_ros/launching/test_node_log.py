from __future__ import annotations

from pathlib import Path

import pytest

from ltm_ros.launching import node_log
from ltm_ros.launching.node_log import NodeLog


def test_lines_go_to_the_file_with_their_time(tmp_path: Path) -> None:
    log = NodeLog(tmp_path / "made" / "north.depth.log", pytest.fail)
    log.write("begun \udcff")
    log.write("done")
    log.close()
    lines = (tmp_path / "made" / "north.depth.log").read_text().splitlines()
    assert [line[24:] for line in lines] == ["begun ?", "done"]
    assert lines[0][:4].isdigit()


def test_old_files_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(node_log, "LOG_BYTES", 300)
    log = NodeLog(tmp_path / "a.log", pytest.fail)
    for i in range(100):
        log.write(f"line {i}")
    log.close()
    names = ["a.log.2", "a.log.1", "a.log"]
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names)
    assert all((tmp_path / name).stat().st_size <= 300 for name in names)
    lines = [line for name in names for line in (tmp_path / name).read_text().splitlines()]
    assert [line.partition(" line ")[2] for line in lines] == [str(i) for i in range(100 - len(lines), 100)]
    assert len(lines) > 15


def test_a_disk_that_takes_nothing_is_told_of_once(tmp_path: Path) -> None:
    told: list[str] = []
    path = tmp_path / "a.log"
    path.symlink_to("/dev/full")
    log = NodeLog(path, told.append)
    for i in range(50):
        log.write(f"line {i}")
    assert told == [f"{path} cannot be written (No space left on device); free some disk space"]
    log.close()
    path.unlink()
    log.write("after")
    log.write("later")
    log.close()
    assert told[1:] == [f"{path} can be written again; 50 lines were lost"]
    assert [line[24:] for line in path.read_text().splitlines()] == ["after", "later"]


def test_a_folder_that_cannot_be_made_is_told_of_too(tmp_path: Path) -> None:
    told: list[str] = []
    (tmp_path / "file").write_text("in the way")
    NodeLog(tmp_path / "file" / "a.log", told.append).write("x")
    assert len(told) == 1
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
