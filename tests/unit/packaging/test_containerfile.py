"""The container runs what the service runs."""

from __future__ import annotations

import json
import re
from pathlib import Path

PACKAGING = Path(__file__).parents[3] / "packaging"
FILE, UNIT = PACKAGING / "Containerfile", PACKAGING / "systemd/ltm.service"


def instructions() -> dict[str, str]:
    text = FILE.read_text().replace("\\\n", " ")
    found = re.findall(r"^([A-Z]+) (.*)$", text, re.MULTILINE)
    assert len(found) == len(dict(found)), "each once"
    return dict(found)


def of_unit(name: str) -> list[str]:
    (value,) = re.findall(rf"^{name}=(.*)$", UNIT.read_text(), re.MULTILINE)
    return str(value).split()


def test_command_environment_and_user_are_the_service_s() -> None:
    said = instructions()
    command = [*json.loads(said["ENTRYPOINT"]), *json.loads(said["CMD"])]
    assert command == [word.replace("--notify", "--no-notify") for word in of_unit("ExecStart")]
    assert set(of_unit("Environment")) < set(said["ENV"].split())
    assert [said["USER"]] == of_unit("User")
    assert [said["WORKDIR"]] == of_unit("WorkingDirectory")


def test_what_stands_for_systemd_satisfies_the_package() -> None:
    depends = (PACKAGING / "debian/control.in").read_text()
    for package in ("systemd-standalone-sysusers", "systemd-standalone-tmpfiles"):
        assert package in instructions()["RUN"]
        assert f"systemd | {package}" in depends
