"""Photos of an archive that are files of their own: how large one may be."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from scenes.small_site import write_small_site

from ltm_core.base.errors import ArchiveError
from ltm_core.site.site_io import load_site
from ltm_core.storage.image_io import LARGEST_FILE
from ltm_ros.archive.content_digest import picture_digest
from ltm_ros.archive.files import ArchiveFiles, CacheConfig, files_below
from ltm_ros.archive.manifest import ArchiveFrame
from ltm_ros.archive.photo_folder import photo_messages, photo_picture
from ltm_ros.archive.pictures import ArchiveImageReader


def test_a_photo_that_is_too_large_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = load_site(write_small_site(tmp_path, recording=False).path)
    folder = tmp_path / "photos"
    folder.mkdir()
    (folder / "poses.csv").write_text("name,camera,stamp\nhuge.jpg,tower,2026-06-01T12:00:00Z\n")
    with (folder / "huge.jpg").open("wb") as file:
        file.truncate(LARGEST_FILE + 1)  # it takes no room
    photo, listed = files_below(str(folder))
    monkeypatch.setattr(Path, "read_bytes", lambda path: pytest.fail(f"{path} is read"))
    (message,) = photo_messages(listed, [photo], site, ArchiveFiles(CacheConfig()))
    assert f"huge.jpg has {LARGEST_FILE + 1} bytes; the maximum is 256 MiB" in message.trouble


def test_a_photo_that_another_has_replaced_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, data = tmp_path / "a.jpg", b"\xff\xd8" + b"photo" * 20
    path.write_bytes(data)
    picture = photo_picture(data, 7)
    frame = ArchiveFrame("tower", 7, str(path), "", 7, len(data), picture_digest(picture), (), (), (), ())
    with ArchiveImageReader(ArchiveFiles(CacheConfig())) as reader:
        assert bytes(reader.read(frame).data) == data
        os.truncate(path, 1 << 40)
        monkeypatch.setattr(Path, "read_bytes", lambda path: pytest.fail(f"{path} is read"))
        with pytest.raises(ArchiveError, match="no longer contains the image"):
            reader.read(frame)
