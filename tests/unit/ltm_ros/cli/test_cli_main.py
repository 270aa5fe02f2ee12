"""The command `ltm`: what it says of itself, and how bad input ends."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from ltm_core.base.errors import ConfigError, RasterError
from ltm_ros.cli import main

COMMANDS = (
    "demo", "init", "check", "run", "replay", "record", "import", "trace", "train", "export", "view",
    "doctor", "status", "upgrade", "rollback", "models", "pose", "locate", "viewshed",
    "fire", "mask", "label", "cameras", "region", "certs", "reprocess",
)  # fmt: skip


def ltm(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"COLUMNS": "200", "NO_COLOR": "1"}
    command = [sys.executable, "-m", "ltm_ros.cli.main", *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str) -> None:
    result = CliRunner().invoke(main.cli, [command, "--help"], env={"COLUMNS": "200"})
    assert result.exit_code == 0, result.output
    assert f"Usage: ltm {command}" in result.output


def test_help_names_every_command() -> None:
    result = CliRunner().invoke(main.cli, ["--help"], env={"COLUMNS": "200"})
    assert result.exit_code == 0
    assert all(f" {command} " in result.output for command in COMMANDS)


def options_of(command: Any, path: str) -> Iterator[tuple[str, int]]:
    """Yield each command below `command` with its number of options."""
    for name, found in getattr(command, "commands", {}).items():
        yield from options_of(found, f"{path} {name}")
    if not hasattr(command, "commands"):
        yield path, sum(parameter.param_type_name == "option" for parameter in command.params)


def test_no_command_has_more_than_fourteen_options() -> None:
    counts = dict(options_of(get_command(main.cli), "ltm"))
    assert len(counts) > len(COMMANDS)
    assert {path: count for path, count in counts.items() if count > 14} == {}


def test_short_help_and_version() -> None:
    told = CliRunner().invoke(main.cli, ["export", "-h"], env={"COLUMNS": "200"})
    assert told.exit_code == 0
    assert "Usage: ltm export" in told.output
    assert CliRunner().invoke(main.cli, ["--version"]).output == f"ltm {version('ltm')}\n"


def test_no_command_stands_twice() -> None:
    named = [*main.cli.registered_commands, *main.cli.registered_groups]
    names = [entry.name or getattr(entry.callback, "__name__", "") for entry in named]
    assert sorted(names) == sorted(COMMANDS)


def test_help_is_quick_because_it_imports_nothing_heavy() -> None:
    heavy = ("rclpy", "rasterio", "numba", "cv2", "onnxruntime", "scipy", "torch", "mitsuba", "rerun", "matplotlib")
    code = f"import ltm_ros.cli.main, sys; print([m for m in {heavy} if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_bad_input_is_a_message_not_a_traceback(tmp_path: Path) -> None:
    """The one test with a process of its own: what follows goes by the runner of the command line's library."""
    result = ltm("export", "absent.tif", "--out", "o.tif", folder=tmp_path)
    assert result.returncode == 1
    assert result.stderr.startswith("ltm: absent.tif: not a raster that GDAL can read")
    assert "Traceback" not in result.stderr


def test_an_unknown_option_is_a_usage_error() -> None:
    result = CliRunner().invoke(main.cli, ["export", "--no-such-option"], env={"COLUMNS": "200", "NO_COLOR": "1"})
    assert result.exit_code == 2
    assert "--no-such-option" in result.stderr


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
        (
            ModuleNotFoundError("No module named 'rerun'", name="rerun.blueprint"),
            "ltm: needs rerun.blueprint: pip install 'ltm[view]', or see `ltm doctor`\n",
        ),
        (
            ModuleNotFoundError("No module named 'rerun'", name="rerun"),
            "ltm: needs rerun: pip install 'ltm[view]'",
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
