import re
import shutil
import subprocess
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[3]
UNITS = REPOSITORY / "packaging/systemd"
UNIT = UNITS / "ltm.service"


def tool(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"needs {name}: apt install systemd")
    return found


def test_the_unit_is_hardened() -> None:
    """Exposure 2.0 at most, of 10; systemd's tools count in tenths."""
    command = [tool("systemd-analyze"), "security", "--offline=yes", "--threshold=20", str(UNIT)]
    ran = subprocess.run(command, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    (level,) = re.findall(r"Overall exposure level for ltm.service: ([\d.]+)", ran.stdout)
    assert 0 < float(level) <= 2.0


def test_systemd_understands_every_line(tmp_path: Path) -> None:
    program = tmp_path / "ltm"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    text = UNIT.read_text()
    assert "/opt/ltm/current/bin/ltm" in text
    unit = tmp_path / "ltm.service"
    text = text.replace("/usr/lib/ltm/release-guard", str(UNITS / "release-guard"))
    unit.write_text(text.replace("/opt/ltm/current/bin/ltm", str(program)))
    ran = subprocess.run([tool("systemd-analyze"), "verify", str(unit)], capture_output=True, text=True)
    assert (ran.returncode, re.findall(r".*ltm\.service.*", ran.stderr)) == (0, []), ran.stderr


def test_the_user_can_be_made(tmp_path: Path) -> None:
    (tmp_path / "etc").mkdir()
    command = [tool("systemd-sysusers"), f"--root={tmp_path}", str(UNITS / "sysusers-ltm.conf")]
    ran = subprocess.run(command, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    line = (tmp_path / "etc/passwd").read_text()
    assert re.fullmatch(r"ltm:x:\d+:\d+:LTM tower:/var/lib/ltm:/usr/sbin/nologin\n", line)
