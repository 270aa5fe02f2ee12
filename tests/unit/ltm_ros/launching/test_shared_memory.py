from __future__ import annotations

import fcntl
import mmap
from pathlib import Path

import pytest

from ltm_ros.launching import shared_memory

SEGMENT = "fastrtps_0123456789abcdef"
PORT = "fastrtps_port7000"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in (SEGMENT, f"{SEGMENT}_el", PORT, f"{PORT}_el", f"sem.{PORT}_mutex", "lttng-ust-wait-6", "fastrtps_x"):
        (tmp_path / name).write_bytes(bytes(4096))
    return tmp_path


def test_removes_what_nobody_owns_and_nothing_else(folder: Path) -> None:
    seen = shared_memory.survey(folder, min_age_s=0.0)
    assert (seen.in_use, seen.stale, seen.young) == ((), (SEGMENT, PORT), ())
    assert seen.stale_bytes >= 3 * 4096
    assert len(list(folder.iterdir())) == 7, "looking removes nothing"
    shared_memory.remove_stale(folder, min_age_s=0.0)
    assert {path.name for path in folder.iterdir()} == {"lttng-ust-wait-6", "fastrtps_x"}


@pytest.mark.parametrize("owned", [SEGMENT, PORT])
def test_leaves_what_is_locked(folder: Path, owned: str) -> None:
    with (folder / f"{owned}_el").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert shared_memory.survey(folder, min_age_s=0.0).in_use == (owned,)
        assert shared_memory.remove_stale(folder, min_age_s=0.0).in_use == (owned,)
        assert (folder / owned).exists()
        assert (folder / f"{owned}_el").exists()
    assert shared_memory.remove_stale(folder, min_age_s=0.0).stale == (owned,)
    assert not (folder / owned).exists()


def test_looking_is_in_nobodys_way(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A participant that starts just then would find its port taken, and a runner leave what is stale."""
    taken: list[int] = []
    flock = fcntl.flock

    def told(descriptor: int, operation: int) -> None:
        taken.append(descriptor)
        flock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", told)
    assert shared_memory.survey(folder, min_age_s=0.0).stale == (SEGMENT, PORT)
    assert taken == []
    shared_memory.remove_stale(folder, min_age_s=0.0)
    assert len(taken) == 2


def test_leaves_a_port_that_a_sender_maps(folder: Path) -> None:
    with (folder / PORT).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ):
        assert shared_memory.remove_stale(folder, min_age_s=0.0).in_use == (PORT,)
        assert (folder / PORT).exists()


def test_leaves_a_mapped_segment_without_lock_file(folder: Path) -> None:
    (folder / f"{SEGMENT}_el").unlink()
    with (folder / SEGMENT).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ):
        assert shared_memory.remove_stale(folder, min_age_s=0.0).in_use == (SEGMENT,)
    assert shared_memory.remove_stale(folder, min_age_s=0.0).stale == (SEGMENT,)


def test_leaves_what_may_just_be_coming_up(folder: Path) -> None:
    seen = shared_memory.remove_stale(folder, min_age_s=3600.0)
    assert (seen.stale, seen.young) == ((), (SEGMENT, PORT))
    assert (folder / SEGMENT).exists()
