import os
from pathlib import Path

import numpy as np
import pytest

from ltm_core.base.errors import StoreError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.surface.confirmed_surface import KEPT, ConfirmedSurface
from ltm_core.surface.surface_versions_io import MANIFEST, SurfaceVersions

GRID = GridGeometry(0.0, 60.0, 2.0, 40, 30)


def felled(height: float) -> ConfirmedSurface:
    rows, cols = np.array([4, 4, 9], np.int32), np.array([7, 8, 2], np.int32)
    ground = np.array([np.nan, np.nan, 98.0], np.float32)
    return ConfirmedSurface(GRID, rows, cols, np.array([height, height, 98.0], np.float32), ground)


@pytest.fixture
def versions(tmp_path: Path) -> SurfaceVersions:
    return SurfaceVersions(tmp_path / "surfaces", "ridge", GRID)


def test_what_was_written_is_read_again(versions: SurfaceVersions) -> None:
    assert versions.manifest().current == ""
    entry = versions.add(felled(101.0), 7_000, 300)
    found = versions.load(entry)
    assert not found.differs_from(felled(101.0), 0.0)
    assert versions.manifest().entry(entry.version) == entry
    assert (entry.cells, entry.seen, entry.changed, entry.lowered) == (1200, 300, 3, 1)
    assert entry.changed_share == pytest.approx(0.01)
    other = SurfaceVersions(versions.folder.parent / "other", "ridge", GRID)
    assert other.add(felled(101.0), 7_000, 300).digest == entry.digest


def test_each_moment_has_its_version(versions: SurfaceVersions) -> None:
    first, second = versions.add(felled(101.0), 1_000, 9), versions.add(felled(99.0), 2_000, 9)
    assert [versions.manifest().at(moment) for moment in (None, 1_500, 500)] == [second, first, None]


def test_the_writer_puts_a_broken_manifest_aside_and_begins_anew(versions: SurfaceVersions) -> None:
    for number in (1, 2):
        entry = versions.add(felled(101.0), 1_000, 9)
        (versions.folder / MANIFEST).write_text("{")
        manifest, told = versions.manifest_of_writer()
        aside = versions.folder.with_name(f"surfaces.{number}")
        assert manifest.current == ""
        assert f"moved to {aside}" in told
        assert (aside / versions.file(entry.version).name).is_file()
    assert versions.manifest_of_writer() == (versions.manifest(), "")
    versions.add(felled(101.0), 1_000, 9)
    with pytest.raises(StoreError, match="is of site ridge, not valley"):
        SurfaceVersions(versions.folder, "valley", GRID).manifest_of_writer()


@pytest.mark.parametrize("when", ["file", "manifest"])
def test_a_writer_that_dies_leaves_the_version_before(
    versions: SurfaceVersions, monkeypatch: pytest.MonkeyPatch, when: str
) -> None:
    before = versions.add(felled(101.0), 1_000, 9)
    whole, dies_at = Path.replace, MANIFEST if when == "manifest" else "surface-"

    def replace(self: Path, target: Path) -> Path:
        if Path(target).name.startswith(dies_at):
            raise OSError(28, "No space left on device")
        return whole(self, target)

    with monkeypatch.context() as broken:
        broken.setattr(Path, "replace", replace)
        with pytest.raises(StoreError, match="No space left"):
            versions.add(felled(99.0), 2_000, 9)
    assert versions.manifest().current == before.version
    assert not versions.load(before).differs_from(felled(101.0), 0.0)
    assert versions.add(felled(99.0), 2_000, 9).parent == before.version


def test_a_file_that_is_not_what_was_written_is_refused(versions: SurfaceVersions) -> None:
    entry = versions.add(felled(101.0), 1_000, 9)
    path = versions.file(entry.version)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    with pytest.raises(StoreError, match="not the file written"):
        versions.load(entry)
    path.unlink()
    with pytest.raises(StoreError, match="cannot be read"):
        versions.load(entry)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"site": "ridge", "current": "../../etc/passwd"}',
        '{"site": 3}',
        '{"site": "ridge", "current": [], "versions": [{"version": {}}, 7]}',
        '{"site": "ridge", "history": [{"version": "0123456789abcdef", "as_of_ns": 3}]}',
    ],
)
def test_a_broken_manifest_is_told(versions: SurfaceVersions, text: str) -> None:
    versions.add(felled(101.0), 1_000, 9)
    (versions.folder / MANIFEST).write_text(text)
    with pytest.raises(StoreError, match="cannot be read as a list of surfaces") as raised:
        versions.manifest()
    assert "\n" not in str(raised.value)


def test_a_folder_that_cannot_be_read_is_no_empty_one(versions: SurfaceVersions) -> None:
    versions.folder.write_text("a file")
    with pytest.raises(StoreError, match=MANIFEST):
        versions.manifest()


def test_old_versions_make_room_but_not_the_one_that_counts(
    versions: SurfaceVersions, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)
    first = versions.add(felled(50.0), 0, 9)
    for number in range(KEPT + 3):
        versions.add(felled(51.0 + number), number, 9)
    found = versions.manifest()
    assert len(found.versions) == KEPT == len(list(versions.folder.glob("*.npz")))
    assert found.entry(first.version) is None
    assert found.entry(found.current) == found.versions[-1]
    kept = found.at(KEPT)
    assert kept is not None
    assert kept.as_of_ns == KEPT
    with pytest.raises(StoreError, match=f"not kept: {KEPT} are kept, the first of 1970-01-01"):
        found.at(1)


def test_files_that_no_manifest_names_are_removed(versions: SurfaceVersions) -> None:
    """A writer was killed after the file and before the manifest."""
    versions.add(felled(101.0), 1_000, 9)
    left, of_others = (versions.folder / name for name in (f"surface-{'0a' * 8}.npz", "surface-of-mine.npz"))
    for path in (left, of_others):
        path.write_bytes(b"")
    entry = versions.add(felled(99.0), 2_000, 9)
    assert (left.exists(), of_others.exists()) == (False, True)
    assert not versions.load(entry).differs_from(felled(99.0), 0.0)
    assert len(list(versions.folder.glob("*.npz"))) == 3
