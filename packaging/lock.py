"""Write `packaging/requirements.lock`: each package that a tower needs, with its version and the SHA-256 of its file.

Run `python packaging/lock.py` with the Python of the towers (Debian 12: 3.11, x86-64), because wheels differ. Versions
are those of constraints.txt. pip reports what it would install; nothing is installed.
"""

import json
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[1]
LOCK = REPOSITORY / "packaging/requirements.lock"
EXTRAS = ("ros", "tower", "rtsp", "region")
"""Extras for all kinds of cameras and the link to a region. The live view (view) is left out, because it is as large as
all others together."""


def requirements() -> list[str]:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    optional: dict[str, list[str]] = project["optional-dependencies"]
    return [*project["dependencies"], *(line for extra in EXTRAS for line in optional[extra])]


def resolved() -> list[dict[str, Any]]:
    """Return what pip would install, as it reports. Raises CalledProcessError."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed"]
        command += ["--constraint", str(REPOSITORY / "constraints.txt"), "--report", str(report), *requirements()]
        subprocess.run(command, check=True)
        installed: list[dict[str, Any]] = json.loads(report.read_text(encoding="utf-8"))["install"]
        return installed


def lock_line(package: dict[str, Any]) -> str:
    """Return the line of a package. Raises SystemExit if the index states no hash."""
    name, version = package["metadata"]["name"].lower().replace("_", "-"), package["metadata"]["version"]
    digest = package["download_info"].get("archive_info", {}).get("hashes", {}).get("sha256")
    if not digest:
        raise SystemExit(f"{name} {version}: no SHA-256 is stated for {package['download_info']['url']}")
    return f"{name}=={version} --hash=sha256:{digest}"


def main() -> None:
    python = ".".join(map(str, sys.version_info[:2]))
    head = (
        f"# Written by packaging/lock.py (`make lock`), Python {python} on x86-64; `make deb` installs exactly this.\n"
    )
    lines = sorted(lock_line(package) for package in resolved())
    LOCK.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")
    print(f"{LOCK.relative_to(REPOSITORY)}: {len(lines)} packages")


if __name__ == "__main__":
    main()
