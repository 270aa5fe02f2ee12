from pathlib import Path

import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.site.sections import FuelConfig
from ltm_core.storage.config_io import LARGEST_DEPTH, LARGEST_FILE, load_yaml, parse_yaml, read_yaml
from ltm_core.storage.disk_io import require_files, require_folder


def load(tmp_path: Path, text: str) -> FuelConfig:
    (tmp_path / "fuel.yaml").write_text(text, encoding="utf-8")
    return load_yaml(tmp_path / "fuel.yaml", FuelConfig)


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


def test_the_line_of_a_wrong_value_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as raised:
        load(tmp_path, "# sizes\nresolution: 30\nexpert:\n  # how\n  steepest_deg: high\nphase: wide\n")
    assert "got 'wide', line 6)" in str(raised.value)
    assert "line 5" in str(raised.value)


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


def billion(levels: int) -> str:
    """Aliases of aliases: 9 to the power of `levels` values in some hundred characters."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    for i in range(levels):
        lines.append(f"a{i + 1}: &a{i + 1} [{', '.join([f'*a{i}'] * 9)}]")
    return "\n".join(lines)


@pytest.mark.parametrize(
    "text",
    [
        "stamp: 2001-13-45",
        'count: !!int ""',
        "count: !!int x",
        "yes: !!bool x",
        "stamp: !!timestamp x",
        'name: "\\Uffffffff"',
        'path: "\\0"',
        'name: "\\ud800"',
        f"count: {'9' * 5000}",
        f"count: 0x{'f' * 5000}",
        "[" * 900 + "]" * 900,
        "{a: " * 60 + "1" + "}" * 60,
        "a: &a [*a]",
        billion(9),
        f"{billion(9)}\nsite: {{<<: [*a8, *a8]}}",
    ],
)
def test_what_is_no_yaml_is_refused_with_its_place(text: str) -> None:
    with pytest.raises(ConfigError, match=r"site\.yaml: not YAML \("):
        parse_yaml(text, "site.yaml")


def test_what_people_write_is_taken() -> None:
    nested = "[" * (LARGEST_DEPTH - 1) + "1" + "]" * (LARGEST_DEPTH - 1)
    assert parse_yaml("a: &a {x: 1}\nb: *a\nc: {<<: *a, y: 2}", "x") == {
        "a": {"x": 1},
        "b": {"x": 1},
        "c": {"x": 1, "y": 2},
    }
    assert parse_yaml(nested, "x")
    assert parse_yaml("stamp: 2024-05-06T07:08:09Z", "x")["stamp"].year == 2024


def test_large_files_are_not_parsed(tmp_path: Path) -> None:
    path = tmp_path / "large.yaml"
    path.write_text("a: 1\n" + "#" * LARGEST_FILE)
    with pytest.raises(ConfigError, match=rf"large\.yaml: cannot be read \(it has more than {LARGEST_FILE} bytes"):
        read_yaml(path)


def test_what_is_read_again_is_the_callers_own_and_tells_its_own_place() -> None:
    text = "cameras: {north: {x: 1}}"
    first = parse_yaml(text, "one.yaml")
    first["cameras"]["north"]["x"] = 2
    assert parse_yaml(text, "two.yaml") == {"cameras": {"north": {"x": 1}}}
    for place in ("one.yaml", "two.yaml"):
        with pytest.raises(ConfigError, match=place):
            parse_yaml("cameras: [", place)


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    (tmp_path / "fuel.yaml").write_bytes(b"phase: \xff\xfe")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_yaml(tmp_path / "fuel.yaml", FuelConfig)
