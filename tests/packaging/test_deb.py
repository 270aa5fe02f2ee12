"""The Debian package, built and tried on a clean Debian with a real systemd. Minutes, root and a package server."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
DEBIAN_PYTHON = Path("/usr/bin/python3")


@pytest.mark.slow
def test_the_package_installs_runs_and_goes(tmp_path: Path) -> None:
    """Without upgrades, which `make try-deb` tries too."""
    if os.geteuid() != 0 or shutil.which("debootstrap") is None or shutil.which("dpkg-deb") is None:
        pytest.skip("needs root, dpkg-deb and debootstrap: apt install debootstrap")
    command = [str(DEBIAN_PYTHON), "-c", "import sys, venv; print(sys.version_info[:2])"]
    asked = subprocess.run(command, capture_output=True, text=True)
    if asked.stdout.strip() != str(sys.version_info[:2]):
        pytest.skip(f"needs Debian's Python of this version, with venv; {DEBIAN_PYTHON}: {asked.stdout.strip()}")
    packaging, out = REPOSITORY / "packaging", REPOSITORY / "out/deb"
    build = [sys.executable, str(packaging / "build_deb.py"), "--out", str(out), "--version", "0.0.0+test"]
    subprocess.run(build, check=True)
    (package,) = out.glob("ltm_0.0.0+test_*.deb")
    package = package.rename(tmp_path / package.name)
    tried = subprocess.run(
        [sys.executable, str(packaging / "try_deb.py"), "--quick", str(package)], capture_output=True, text=True
    )
    if tried.returncode == 2:
        pytest.skip(tried.stderr.strip())
    assert tried.returncode == 0, tried.stdout + tried.stderr
    assert tried.stdout.endswith("all checks passed\n")
    assert tried.stdout.count(" holds ") > 15
