import fcntl
import mmap
from pathlib import Path

import pytest

from ltm_ros.launching.shared_memory import remove_stale

SEGMENT = "fastrtps_0123456789abcdef"
PORT = "fastrtps_port7000"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in (SEGMENT, f"{SEGMENT}_el", PORT, f"{PORT}_el", f"sem.{PORT}_mutex", "lttng-ust-wait-6", "fastrtps_x"):
        (tmp_path / name).write_bytes(bytes(4096))
    return tmp_path


def test_removes_what_nobody_owns_and_nothing_else(folder: Path) -> None:
    assert not remove_stale(folder, min_age_s=0.0)
    assert {path.name for path in folder.iterdir()} == {"lttng-ust-wait-6", "fastrtps_x"}


@pytest.mark.parametrize("owned", [SEGMENT, PORT])
def test_leaves_what_is_locked(folder: Path, owned: str) -> None:
    with (folder / f"{owned}_el").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        remove_stale(folder, min_age_s=0.0)
        assert (folder / owned).exists()
        assert (folder / f"{owned}_el").exists()
    remove_stale(folder, min_age_s=0.0)
    assert not (folder / owned).exists()


def test_leaves_a_port_that_a_sender_maps(folder: Path) -> None:
    with (folder / PORT).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ):
        remove_stale(folder, min_age_s=0.0)
        assert (folder / PORT).exists()


def test_leaves_a_mapped_segment_without_lock_file(folder: Path) -> None:
    (folder / f"{SEGMENT}_el").unlink()
    with (folder / SEGMENT).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ):
        remove_stale(folder, min_age_s=0.0)
        assert (folder / SEGMENT).exists()
    remove_stale(folder, min_age_s=0.0)
    assert not (folder / SEGMENT).exists()


def test_leaves_what_may_just_be_coming_up(folder: Path) -> None:
    assert remove_stale(folder, min_age_s=3600.0)
    assert (folder / SEGMENT).exists()
