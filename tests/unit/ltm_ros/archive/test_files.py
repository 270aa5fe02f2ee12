"""Files of archives: found at any depth, and none that was replaced."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from scenes.small_site import write_small_site

from ltm_core.base.errors import ArchiveError
from ltm_core.site.site_io import load_site
from ltm_core.storage.image_io import LARGEST_FILE
from ltm_ros.archive.content_digest import picture_digest
from ltm_ros.archive.files import files_below
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.pictures import ArchiveImageReader
from ltm_ros.archive.scan import photo_messages, photo_picture, recordings


def test_what_lies_behind_links_belongs_to_an_archive(tmp_path: Path) -> None:
    """A folder on another disk, once; a link to the folder itself ends; one that leads nowhere is not passed over."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk/a.mcap").write_bytes(b"four")
    (tmp_path / "archive").mkdir()
    for name, to in {"2025": tmp_path / "disk", "again": tmp_path / "disk", "loop": tmp_path / "archive"}.items():
        (tmp_path / "archive" / name).symlink_to(to)
    (tmp_path / "archive/away.mcap").symlink_to(tmp_path / "not_mounted/away.mcap")
    found = files_below(tmp_path / "archive")
    assert [(file.name, file.size_bytes) for file in found] == [
        (str(tmp_path / "archive/2025/a.mcap"), 4),
        (str(tmp_path / "archive/away.mcap"), 0),
    ]


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


def test_a_photo_that_is_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = load_site(write_small_site(tmp_path, recording=False).path)
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "poses.csv").write_text("name,camera,stamp\nhuge.jpg,tower,2026-06-01T12:00:00Z\n")
    with (folder / "huge.jpg").open("wb") as file:
        file.truncate(LARGEST_FILE + 1)  # it takes no room
    photo, listed = files_below(folder)
    monkeypatch.setattr(Path, "read_bytes", lambda path: pytest.fail(f"{path} is read"))
    (message,) = photo_messages(listed, [photo], site)
    assert f"huge.jpg has {LARGEST_FILE + 1} bytes; the maximum is 256 MiB" in message.trouble


def test_a_photo_that_another_has_replaced_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, data = tmp_path / "a.jpg", b"\xff\xd8" + b"photo" * 20
    path.write_bytes(data)
    picture = photo_picture(data, 7)
    frame = ArchiveFrame("tower", 7, str(path), "", 7, len(data), picture_digest(picture), (), (), (), ())
    reader = ArchiveImageReader()
    assert bytes(reader.read(frame).data) == data
    os.truncate(path, 1 << 40)
    monkeypatch.setattr(Path, "read_bytes", lambda path: pytest.fail(f"{path} is read"))
    with pytest.raises(ArchiveError, match="no longer contains the image"):
        reader.read(frame)


def test_a_file_of_any_name_is_a_recording_also_by_a_link(tmp_path: Path) -> None:
    (tmp_path / "recorded.bin").write_bytes(b"content")
    (tmp_path / "today").symlink_to(tmp_path / "recorded.bin")
    assert [found.name for found in recordings([tmp_path / "today"])] == [str(tmp_path / "recorded.bin")]
