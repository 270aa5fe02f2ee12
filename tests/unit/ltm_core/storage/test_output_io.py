"""Whether a place can be written, before anything is."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.storage.disk_io import require_files, require_folder


def test_places_that_can_be_written_are_left_as_they_are(tmp_path: Path) -> None:
    there = tmp_path / "there.tif"
    there.write_text("old")
    require_folder(tmp_path)
    require_folder(tmp_path / "to/be/made")
    require_files([tmp_path / "new.tif", tmp_path / "deep/new.tif"], overwrite=False)
    require_files([there])
    assert [p.name for p in tmp_path.iterdir()] == ["there.tif"]
    assert there.read_text() == "old"


def test_what_is_there_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "there.tif").touch()
    with pytest.raises(ConfigError, match=r"there.tif: exists already; .* --overwrite"):
        require_files([tmp_path / "new.tif", tmp_path / "there.tif"], overwrite=False)


def test_places_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match=r"file/out: cannot write the map \(.*file is no(t a)? folder\)"):
        require_folder(tmp_path / "file/out", "the map")
    with pytest.raises(ConfigError, match=r"map.tif: cannot write results"):
        require_files([tmp_path / "file/map.tif"])
    with pytest.raises(ConfigError, match=r"is a folder; give a file name for results"):
        require_files([tmp_path])
    # No file can be made there, whoever asks.
    with pytest.raises(ConfigError, match=r"/proc/ltm: cannot write results \("):
        require_folder(Path("/proc/ltm"))
    with pytest.raises(ConfigError, match=r"/proc/version/x: cannot write results \("):
        require_files([Path("/proc/version/x")])


def test_names_that_are_too_long_for_a_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"map: cannot write the map \(File name too long\)"):
        require_folder(tmp_path / ("long" * 70 + "map"), "the map")
    with pytest.raises(ConfigError, match=r"map.tif: cannot write results \(File name too long\)"):
        require_files([tmp_path / ("long" * 70 + "map.tif")])
