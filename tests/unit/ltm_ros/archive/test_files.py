"""Files of archives: found at any depth, and none that was replaced."""

import os
from pathlib import Path

import pytest

from ltm_ros.archive.scan import files_below, recordings, write_result


def test_what_lies_behind_links_belongs_to_an_archive(tmp_path: Path) -> None:
    """A folder on another disk, once; a link to the folder itself ends; one that leads nowhere is not passed over."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk/a.mcap").write_bytes(b"four")
    (tmp_path / "archive").mkdir()
    for name, to in {"2025": tmp_path / "disk", "again": tmp_path / "disk", "loop": tmp_path / "archive"}.items():
        (tmp_path / "archive" / name).symlink_to(to)
    (tmp_path / "archive/away.mcap").symlink_to(tmp_path / "not_mounted/away.mcap")
    found = files_below(tmp_path / "archive")
    assert found == [tmp_path / "archive/2025/a.mcap", tmp_path / "archive/away.mcap"]


def test_a_folder_that_cannot_be_read_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else its recordings are missing from the map, and nobody knows."""
    (tmp_path / "a/shut").mkdir(parents=True)
    (tmp_path / "a/one.mcap").write_bytes(b"1")
    look = os.scandir

    def refused(place: str) -> object:
        if Path(place).name == "shut":
            raise PermissionError(13, "Permission denied", str(place))
        return look(place)

    monkeypatch.setattr(os, "scandir", refused)
    with pytest.raises(PermissionError, match="shut"):
        files_below(tmp_path)


def test_a_file_of_any_name_is_a_recording_also_by_a_link(tmp_path: Path) -> None:
    (tmp_path / "recorded.bin").write_bytes(b"content")
    (tmp_path / "today").symlink_to(tmp_path / "recorded.bin")
    assert recordings([tmp_path / "today"]) == [tmp_path / "recorded.bin"]


def test_a_file_is_on_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced, sync = list[tuple[bool, int]](), os.fsync

    def watched(file: int) -> None:
        synced.append(((tmp_path / "votes/a.parquet").exists(), os.fstat(file).st_size))
        sync(file)

    monkeypatch.setattr(os, "fsync", watched)
    write_result(tmp_path / "votes/a.parquet", b"content")
    assert synced == [(False, 7)]
    assert [(file.name, file.read_bytes()) for file in (tmp_path / "votes").iterdir()] == [("a.parquet", b"content")]
