"""The folder of results: whole files, and words where it cannot be used."""

from __future__ import annotations

import os
from pathlib import Path

import fsspec
import pytest

from ltm_core.base.errors import ArchiveError
from ltm_ros.archive.results import ResultFolder


def test_a_file_is_on_disk_before_it_has_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced, sync = list[tuple[bool, int]](), os.fsync

    def watched(file: int) -> None:
        synced.append(((tmp_path / "votes/a.parquet").exists(), os.fstat(file).st_size))
        sync(file)

    monkeypatch.setattr(os, "fsync", watched)
    results = ResultFolder(str(tmp_path))
    results.write("votes/a.parquet", b"content")
    assert synced == [(False, 7)]
    assert results.names("votes") == {"a.parquet"}
    assert results.read("votes/a.parquet") == b"content"


def test_folders_are_no_files(tmp_path: Path) -> None:
    """Somebody has put one beside the layers; they are what is removed when a later run has not written them."""
    for url in (str(tmp_path), "memory://folders"):
        results = ResultFolder(url)
        results.write("layers/code.tif", b"content")
        results.write("layers/mine/notes.txt", b"content")
        assert results.names("layers") == {"code.tif"}
        assert results.names("nothing") == set()


def test_a_store_that_fails_in_whatever_way_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """As that of S3, whose library has errors that are no OSError."""

    class EndpointConnectionError(Exception):
        pass

    def broken(*given: object, **more: object) -> None:
        raise EndpointConnectionError("no route")

    results = ResultFolder("memory://year")
    results.write("a", b"content")
    for function in ("pipe_file", "cat_file", "exists"):
        monkeypatch.setattr(fsspec.get_filesystem_class("memory"), function, broken)
    for use in (lambda: results.write("a", b""), lambda: results.read("a"), lambda: results.names("a")):
        with pytest.raises(ArchiveError, match=r"memory://year cannot be used now \(EndpointConnectionError"):
            use()
    with pytest.raises(ArchiveError, match="cannot be used now"):
        results.has("a")
    with pytest.raises(ArchiveError, match="cannot be used now"), results.open("a"):
        broken()  # a store that serves parts fails as late as when they are read


@pytest.mark.parametrize("remote", [False, True])
def test_a_file_is_copied_as_it_is_and_read_in_parts(tmp_path: Path, remote: bool) -> None:
    content = bytes(range(251)) * 4000
    (tmp_path / "made").write_bytes(content)
    results = ResultFolder("memory://copies" if remote else str(tmp_path / "out"))
    results.put(tmp_path / "made", "maps/terrain.sqlite")
    assert results.names("maps") == {"terrain.sqlite"}
    assert results.read("maps/terrain.sqlite") == content
    with results.open("maps/terrain.sqlite") as file:
        file.seek(251)
        assert file.read(2) == b"\x00\x01"
