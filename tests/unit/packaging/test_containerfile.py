import json
import re
from fnmatch import fnmatch
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
    assert command == of_unit("ExecStart")
    assert set(of_unit("Environment")) < set(said["ENV"].split())
    assert [said["USER"]] == of_unit("User")
    assert [said["WORKDIR"]] == of_unit("WorkingDirectory")


def test_what_it_copies_is_what_is_built_and_what_it_runs_is_what_is_installed() -> None:
    said, builder = instructions(), (PACKAGING / "build_deb.py").read_text()
    pattern, target = said["COPY"].split()
    (built,) = re.findall(r"f\"(ltm_\{version\}_.*?\.deb)\"", builder)
    name = built.replace("{version}", "0.2.0")
    assert fnmatch(name, pattern), "a package's name"
    assert fnmatch(target + name, re.search(r"/tmp/ltm\S+\.deb", said["RUN"])[0])  # type: ignore[index]
    assert said["RUN"].count(f"{target}{pattern}") == 2, "installed, then removed"
    # The package is for the Python of the release that it starts from.
    assert said["FROM"] == "debian:12-slim"
    (program,) = json.loads(said["ENTRYPOINT"])
    assert program.startswith("/opt/ltm/current/")
    assert "/opt/ltm/.current.new /opt/ltm/current" in (PACKAGING / "debian/postinst").read_text()
    folders = (PACKAGING / "systemd/tmpfiles-ltm.conf").read_text()
    for path in (said["VOLUME"], said["WORKDIR"], *[w for w in json.loads(said["CMD"]) if w.startswith("/var/")]):
        assert re.search(rf"^d {path} \S+ {said['USER']} ", folders, re.MULTILINE), f"{path} is made for its user"
    page = (PACKAGING.parent / "docs/deployment.md").read_text()
    assert "docker build --file packaging/Containerfile --tag ltm out/deb" in page
    assert f"--volume ltm-state:{said['VOLUME']} " in page


def test_what_stands_for_systemd_satisfies_the_package() -> None:
    depends = (PACKAGING / "debian/control.in").read_text()
    for package in ("systemd-standalone-sysusers", "systemd-standalone-tmpfiles"):
        assert package in instructions()["RUN"]
        assert f"systemd | {package}" in depends
