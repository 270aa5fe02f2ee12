import errno
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from ltm_core.base.errors import ConfigError, RasterError
from ltm_ros.cli import main
from ltm_ros.cli.demo import to_type


def ltm(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"COLUMNS": "200", "NO_COLOR": "1"}
    command = [sys.executable, "-m", "ltm_ros.cli.main", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)


def described(command: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path and the description of the command line and of each command below it."""
    yield path, command
    for name, below in getattr(command, "commands", {}).items():
        yield from described(below, f"{path} {name}".strip())


ALL = dict(described(get_command(main.cli)))


@pytest.mark.parametrize("path", ALL)
def test_every_command_explains_itself_with_examples_and_says_what_goes_in(path: str) -> None:
    result = CliRunner().invoke(main.cli, [*path.split(), "--help"], env={"COLUMNS": "200"}, prog_name="ltm")
    assert result.exit_code == 0, result.output
    assert f"Usage: ltm {path}".strip() in result.output
    assert re.search(rf"Examples:\s+ltm {path}", result.output)
    assert [p.name for p in ALL[path].params if p.param_type_name == "option" and not p.help] == []
    assert (
        re.findall(r"<(?:str|int|float|path|bool|list)\b[^>]*>|\b(?:TEXT|INTEGER|FLOAT|PATH|BOOLEAN)\b", result.output)
        == []
    )


@pytest.mark.parametrize(("path", "line"), [(path, line) for path, lines in main.EXAMPLES.items() for line in lines])
def test_the_examples_parse(path: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert line.startswith(f"ltm {path}".strip())
    words = shlex.split(line)[1:]
    below = max((p for p in ALL if words[: len(p.split())] == p.split()), key=len)
    ALL[below].make_context(below, words[len(below.split()) :])  # raises a usage error for what does not parse


def test_help_names_every_command() -> None:
    result = CliRunner().invoke(main.cli, ["--help"], env={"COLUMNS": "200"})
    assert result.exit_code == 0
    assert all(f" {command} " in result.output for command in main.Commands())


def test_no_command_has_more_than_fourteen_options() -> None:
    counts = {path: sum(p.param_type_name == "option" for p in command.params) for path, command in ALL.items()}
    assert len(counts) > len(main.Commands()) >= 27
    assert {path: count for path, count in counts.items() if count > 14} == {}


def test_the_demo_ends_with_a_command_that_works_in_the_users_shell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "prefix", str(tmp_path / ".venv"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    assert to_type("ltm view") == "source .venv/bin/activate && ltm view"
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/ltm").touch(mode=0o755)
    assert to_type("ltm view") == "ltm view"


def test_help_is_quick_because_it_imports_nothing_heavy() -> None:
    heavy = ("rclpy", "rasterio", "numba", "cv2", "onnxruntime", "scipy", "torch", "mitsuba", "rerun", "matplotlib")
    code = f"import ltm_ros.cli.main, sys; print([m for m in {heavy} if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_help_of_each_command_loads_no_part_of_scipy() -> None:
    code = """
import sys
from ltm_ros.cli.main import Commands
commands = Commands()
for name in commands:
    commands[name]
print([name for name in ("scipy.linalg", "scipy.optimize", "scipy.special") if name in sys.modules])
"""
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_bad_input_is_a_message_not_a_traceback(tmp_path: Path) -> None:
    """The one test with a process of its own: what follows goes by the runner of the command line's library."""
    result = ltm("export", "absent.tif", "--out", "o.tif", folder=tmp_path)
    assert result.returncode == 1
    assert result.stderr.startswith("ltm: absent.tif: not a raster that GDAL can read")
    assert "Traceback" not in result.stderr


def test_offline_replay_knows_no_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(main.cli, ["replay", "bag", "--site", "s.yaml", "--offline", "--rate", "2"])
    assert isinstance(result.exception, ConfigError)
    assert "--offline ignores time" in str(result.exception)
    assert not any(tmp_path.iterdir())


def _raising(error: Exception) -> None:
    raise error


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (RasterError("dem.tif: broken"), "ltm: dem.tif: broken\n"),
        (
            OSError(errno.ENOSPC, "No space left on device", "out/map.png"),
            "ltm: out/map.png: No space left on device\n",
        ),
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "photos"), "ltm: photos: No such file"),
        (
            ModuleNotFoundError("No module named 'rerun'", name="rerun.blueprint"),
            "ltm: needs rerun.blueprint: pip install 'ltm[view]', or see `ltm doctor`\n",
        ),
    ],
)
def test_what_a_user_can_mend(
    error: Exception, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(main, "cli", lambda: _raising(error))
    with pytest.raises(SystemExit) as ended:
        main.app()
    assert ended.value.code == 1
    assert capsys.readouterr().err.startswith(message)


@pytest.mark.parametrize(
    "error", [ModuleNotFoundError("x", name="ltm_core.absent"), ZeroDivisionError("bug"), OSError(errno.EBADF, "bug")]
)
def test_bugs_keep_their_traceback(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(main, "cli", lambda: _raising(error))
    with pytest.raises(type(error)):
        main.app()
