"""The command `ltm` in this process."""

from typer.testing import CliRunner

from ltm_ros.cli.main import cli


def ltm(*words: object, status: int = 0, typed: str | None = None, **environment: str) -> str:
    """Return what a command prints. Its error is raised; another end than `status` fails the test."""
    result = CliRunner().invoke(cli, list(map(str, words)), input=typed, env={"COLUMNS": "200"} | environment)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == status, result.output
    return result.output
