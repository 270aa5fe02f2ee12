"""`ltm-lab eval canopy`: what it refuses."""

from __future__ import annotations

import pytest
from typer.testing import CliRunner

from ltm_core.base.errors import ConfigError
from ltm_lab.cli.main import cli


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--seeds", "23,a"], "whole numbers"),
        (["--scenes", "flood"], "no scene 'flood'"),
        (["--climate", "moon"], "moon"),
        (["--depth", "true"], "give --frames"),
    ],
)
def test_what_cannot_be_is_told(options: list[str], told: str) -> None:
    result = CliRunner().invoke(cli, ["eval", "canopy", *options])
    assert isinstance(result.exception, ConfigError)
    assert told in str(result.exception)
