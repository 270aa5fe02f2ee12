"""`ltm reprocess` of archives on disks that fail."""

import errno
from pathlib import Path

import pytest
from mcap.records import Chunk
from scenes.own_disk import run_on_own_disk
from scenes.small_site import FRAMES, SmallSite

from ltm_core.base.errors import ArchiveError
from ltm_ros.archive.run import ArchiveOptions, Summary, look_through, run
from ltm_ros.archive.task import serial

DISK = Path(__file__).parents[1] / "scenes" / "archive_disk_process.py"


def reprocessed(options: ArchiveOptions) -> Summary:
    return run(look_through(options, lambda done, total: None), serial, lambda done, total: None)


def test_a_disk_that_fails_for_a_while_is_no_result(
    small_site: SmallSite, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a network's file system does: chunks of a recording that cannot be read are not chunks that are broken."""

    def failing(stream: object) -> Chunk:
        raise OSError(errno.EIO, "Input/output error")

    options = ArchiveOptions((small_site.bag,), small_site.path, tmp_path / "out", max_failed=1.0)
    with monkeypatch.context() as patched:
        patched.setattr(Chunk, "read", failing)
        with pytest.raises(ArchiveError, match=r"cannot be read now: .*Input/output error"):
            reprocessed(options)
    planned = look_through(options, lambda done, total: None)
    with monkeypatch.context() as patched:
        patched.setattr(Chunk, "read", failing)
        with pytest.raises(ArchiveError, match="Input/output error"):
            run(planned, serial, lambda done, total: None)
    assert reprocessed(options).digest == expected


def test_a_disk_that_fills_up_while_a_run_writes_is_named_and_the_run_goes_on_when_there_is_room(
    small_site: SmallSite, expected: str, tmp_path: Path
) -> None:
    (tmp_path / "disk").mkdir()
    found = run_on_own_disk(DISK, "full", tmp_path / "disk", small_site.folder)
    assert "No space left on device" in found["said"]
    assert (found["maps"], found["partial"]) == ([], []), "no map, and no file that is not whole"
    assert (found["digest"], found["frames"]) == (expected, 2 * FRAMES)
    assert 0 < found["worked"] < 2 * FRAMES, "what was done before stays done"
