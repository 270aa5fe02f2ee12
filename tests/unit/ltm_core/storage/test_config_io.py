"""What a reader of a wrong YAML file is told, and whether a place can be written, before anything is."""

from __future__ import annotations

from pathlib import Path

import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.site.sections import FuelConfig
from ltm_core.site.site import Site
from ltm_core.storage.config_io import checked, load_yaml
from ltm_core.storage.disk_io import require_files, require_folder


def load(tmp_path: Path, text: str) -> FuelConfig:
    (tmp_path / "fuel.yaml").write_text(text, encoding="utf-8")
    return load_yaml(tmp_path / "fuel.yaml", FuelConfig)


def test_only_what_differs_is_stated(tmp_path: Path) -> None:
    assert load(tmp_path, "max_range: 4500") == FuelConfig(max_range=4500.0)


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        ("resolutoin: 30", ["resolutoin: unknown key", "resolution, phase, max_range"]),
        ("resolution: -3", ["resolution: Input should be greater than 0", "got -3"]),
        ("phase: wide", ["phase", "got 'wide'"]),
        ("phase: .nan", ["phase", "finite", "got nan"]),
        ("resolution: 0\nphase: x", ["resolution:", "phase:"]),  # all that is wrong, at once
        ("- 30", ["expected a mapping", "list"]),
        ("", ["expected a mapping", "NoneType"]),
        ("phase: [15", ["not YAML"]),
        ("phase: 15\nresolution: 30\nphase: 0", ["'phase' is repeated", "line 3"]),
    ],
)
def test_wrong_files(tmp_path: Path, text: str, messages: list[str]) -> None:
    with pytest.raises(ConfigError) as raised:
        load(tmp_path, text)
    for message in ["fuel.yaml", *messages]:
        assert message in str(raised.value)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"absent\.yaml: cannot be read \(No such file"):
        load_yaml(tmp_path / "absent.yaml", FuelConfig)
    with pytest.raises(ConfigError, match="Is a directory"):
        load_yaml(tmp_path, FuelConfig)


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    (tmp_path / "fuel.yaml").write_bytes(b"phase: \xff\xfe")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_yaml(tmp_path / "fuel.yaml", FuelConfig)


def test_merged_keys_may_be_overridden(tmp_path: Path) -> None:
    (tmp_path / "site.yaml").write_text(
        "{name: a, crs: EPSG:32611, origin: [0, 0], dem: {path: d.tif},"
        " cameras: {one: {pose: &p {x: 1, y: 2, z: 3, azimuth_deg: 4}}, two: {pose: {<<: *p, azimuth_deg: 90}}}}"
    )
    pose = load_yaml(tmp_path / "site.yaml", Site).cameras["two"].pose
    assert pose is not None
    assert (pose.z, pose.azimuth_deg) == (3.0, 90.0)


def test_missing_and_nested_keys_are_named() -> None:
    with pytest.raises(ConfigError) as raised:
        checked(Site, {"name": "a", "dem": {"path": "d.tif", "size": 3}, "cameras": {"b": {"pose": {"x": 1}}}}, "here")
    lines = str(raised.value).splitlines()
    assert lines[0] == "here:"
    assert {
        "  crs: missing",
        "  origin: missing",
        "  dem.size: unknown key",
        "  cameras.b.pose.azimuth_deg: missing",
    } <= {*lines}


def test_the_line_of_a_wrong_value_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as raised:
        load(tmp_path, "# sizes\nresolution: 30\nfusion:\n  # how\n  memory_days: often\nphase: wide\n")
    assert "got 'wide', line 6)" in str(raised.value)
    assert "line 5" in str(raised.value)


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
