from pathlib import Path
from typing import Any

import pytest

from ltm_core.base.errors import ConfigError, RecordingError

pytest.importorskip("rerun", reason="the viewer's extra is not installed")

from ltm_ros.cli.view import view as view_command


@pytest.mark.parametrize(
    ("given", "error", "remedy"),
    [
        ({}, ConfigError, "one of --site"),
        ({"site": Path("a.yaml"), "rrd": Path("b.rrd")}, ConfigError, "one of --site"),
        ({"rrd": Path("b.rrd"), "connect": "tower"}, ConfigError, "one of --site"),
        ({"connect": "tower", "save": Path("b.rrd")}, ConfigError, "--save"),
        ({"site": Path("a.yaml"), "token": Path("token")}, ConfigError, "--connect"),
        ({"connect": "http://192.0.2.7", "web_port": 0}, ConfigError, "unencrypted"),
        ({"rrd": Path("no/such.rrd")}, RecordingError, r"no/such\.rrd: no such recording"),
    ],
)
def test_view_command_refuses_what_it_cannot_show(given: dict[str, Any], error: type[Exception], remedy: str) -> None:
    with pytest.raises(error, match=remedy):
        view_command(**given)
