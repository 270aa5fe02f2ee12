"""Reads a Debian package of ours, and unpacks the release in it beside the others."""

from __future__ import annotations

import os
import shutil
import subprocess  # nosec B404 # argument lists, no shell
from dataclasses import dataclass
from pathlib import Path

from ltm_core.errors import ConfigError, LtmError
from ltm_ros.deployment.releases import Releases, checked_version

NAME = "ltm"
ROOM = 1.2
"""Times the size of a release must be free."""


class PackageError(LtmError):
    """A package that is not ours, or damaged, or for which there is no room."""


@dataclass(frozen=True)
class PackageFile:
    path: Path
    version: str
    size: int
    """Bytes of its files once unpacked."""

    @classmethod
    def open(cls, path: Path) -> PackageFile:
        """Raises PackageError."""
        if not path.is_file():
            raise PackageError(f"{path}: no such file")
        fields = dict(_field(path, name) for name in ("Package", "Version", "Architecture", "Installed-Size"))
        if fields["Package"] != NAME:
            raise PackageError(f"{path}: package {fields['Package']!r}, expected {NAME!r}")
        machine = _output("dpkg", "--print-architecture")
        if fields["Architecture"] != machine:
            raise PackageError(f"{path}: for {fields['Architecture']}, this machine is {machine}")
        size = fields["Installed-Size"]
        try:
            return cls(path.resolve(), checked_version(fields["Version"]), int(size) * 1024 if size.isdecimal() else 0)
        except ConfigError as error:
            raise PackageError(f"{path}: {error}") from error

    def unpack(self, releases: Releases) -> Path:
        """The release of this package as a folder beside the others; it bears its name only when it is whole.

        Raises PackageError: no room, damaged, or without a release of its own version.
        """
        free = shutil.disk_usage(releases.root).free
        if free < ROOM * self.size:
            raise PackageError(
                f"{releases.root}: {free / 1e6:.0f} MB free, {ROOM * self.size / 1e6:.0f} MB are needed: make room"
            )
        partial = releases.root / ".unpacked"
        shutil.rmtree(partial, ignore_errors=True)
        try:
            _run("dpkg-deb", "--extract", str(self.path), str(partial))
            found = partial / "opt/ltm/releases" / self.version
            if not (found / "bin/ltm").is_file():
                raise PackageError(f"{self.path}: holds no release {self.version}")
            target = releases.folder(self.version)
            if target.exists():
                shutil.rmtree(target)
            os.utime(found)  # when it came here, not when it was built
            os.sync()
            found.rename(target)
            return target
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def _field(path: Path, name: str) -> tuple[str, str]:
    return name, _output("dpkg-deb", "--field", str(path), name)


def _run(*command: str) -> None:
    _output(*command)


def _output(*command: str) -> str:
    try:
        ran = subprocess.run(command, capture_output=True, text=True, errors="replace")  # nosec B603 # no shell
    except FileNotFoundError as error:
        raise PackageError(f"{command[0]}: not found: packages are installed on Debian and its kin") from error
    if ran.returncode:
        said = ran.stderr.strip().splitlines()
        raise PackageError(f"{' '.join(command)}: {said[-1] if said else f'exit code {ran.returncode}'}")
    return ran.stdout.strip()
