"""List installed releases, and unpack the release of a Debian package beside them."""

import contextlib
import os
import re
import shutil
import subprocess  # nosec B404 # argument lists, no shell
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.storage.disk_io import free_bytes, sync

ROOT = Path("/opt/ltm")
_VERSION = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+~-]*")


class UpgradeError(LtmError):
    """A package, a release or a program of the system failed. The previous release runs, unless the message says
    otherwise."""


def checked_version(version: str) -> str:
    """Return a version that is a valid folder name. Raises ConfigError."""
    if not _VERSION.fullmatch(version):
        raise ConfigError(f"version {version!r}: expected letters, digits and . + ~ - as Debian allows")
    return version


@dataclass(frozen=True)
class Trial:
    """A release that is current but not confirmed; `former` returns if it fails."""

    former: str
    candidate: str
    copy: str
    """Folder with the copy of the stores made under `former`; empty: there was none."""
    watched_s: int
    """Seconds from its first start after which the guard must check whether it is ready."""


class Releases:
    """`ROOT/releases/VERSION` are complete releases; `ROOT/current` links to one.

    A trial survives a power cut: `ROOT/trial` names it, and the service's start reads it first
    (`packaging/systemd/release-guard`)."""

    def __init__(self, root: Path = ROOT) -> None:
        self.root = root
        self._folder = root / "releases"
        self._trial = root / "trial"

    @property
    def current(self) -> str:
        """Return the current version. Raises ConfigError if this is no installed tower."""
        link = self.root / "current"
        try:
            return link.readlink().name
        except OSError as error:
            raise ConfigError(
                f"{link}: {error.strerror}: upgrade and rollback need a tower installed from the package "
                "(docs/deployment.md)"
            ) from error

    @property
    def installed(self) -> list[str]:
        """Return the versions in the order in which they were unpacked."""
        folders = [path for path in self._folder.iterdir() if path.is_dir() and not path.name.startswith(".")]
        return [path.name for path in sorted(folders, key=lambda path: (path.stat().st_mtime, path.name))]

    def folder(self, version: str) -> Path:
        return self._folder / checked_version(version)

    def program(self, version: str) -> Path:
        """Return a program of a release. Raises ConfigError that lists the releases."""
        program = self.folder(version) / "bin/ltm"
        if not program.exists():
            raise ConfigError(f"no release {version} in {self._folder}; installed: {', '.join(self.installed)}")
        return program

    def other(self) -> str:
        """Return the release to return to: the one that ran before, else the newest other one.

        Raises ConfigError if there is none."""
        others = [version for version in self.installed if version != self.current]
        if not others:
            raise ConfigError(
                f"{self._folder} holds only release {self.current}: there is no other release to return to"
            )
        link = self.root / "former"
        ran = link.readlink().name if link.is_symlink() else ""
        return ran if ran in others else others[-1]

    def switch(self, version: str) -> None:
        """Switch atomically: after a power cut, either release is current. Raises ConfigError."""
        self.program(version)
        former = self.current
        if former != version:
            self._link("former", former)
        self._link("current", version)
        sync(self.root)

    def _link(self, name: str, version: str) -> None:
        link = self.root / f".{name}.new"
        link.unlink(missing_ok=True)
        link.symlink_to(Path("releases") / version)
        link.replace(self.root / name)

    def remove(self, version: str) -> None:
        """Remove a release that does not run."""
        shutil.rmtree(self.folder(version), ignore_errors=True)
        link = self.root / "former"
        if link.is_symlink() and link.readlink().name == version:
            link.unlink()

    @property
    def trial(self) -> Trial | None:
        try:
            former, candidate, copy, watched_s = (self._trial / "release").read_text(encoding="utf-8").splitlines()
            return Trial(former, candidate, copy, int(watched_s))
        except (OSError, ValueError):
            return None

    def begin_trial(self, trial: Trial) -> None:
        """Begin a trial before the switch: a second start of the service during it means failure."""
        self.end_trial()
        self._trial.mkdir(mode=0o755)
        partial = self._trial / ".release"
        lines = trial.former, trial.candidate, trial.copy, trial.watched_s
        partial.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        sync(partial)
        partial.rename(self._trial / "release")
        sync(self._trial)

    def end_trial(self) -> None:
        for name in ("release", ".release", "started"):
            (self._trial / name).unlink(missing_ok=True)
        with contextlib.suppress(FileNotFoundError):
            self._trial.rmdir()
        sync(self.root)


NAME = "ltm"
ROOM = 1.2
"""Required free space, as a multiple of the release's size."""


@dataclass(frozen=True)
class PackageFile:
    path: Path
    version: str
    size: int
    """Bytes of its unpacked files."""

    @classmethod
    def open(cls, path: Path) -> "PackageFile":
        """Open a package. Raises UpgradeError."""
        if not path.is_file():
            raise UpgradeError(f"{path}: no such file")
        names = ("Package", "Version", "Architecture", "Installed-Size")
        fields = {name: program_output("dpkg-deb", "--field", str(path), name) for name in names}
        if fields["Package"] != NAME:
            raise UpgradeError(f"{path}: package {fields['Package']!r}, expected {NAME!r}")
        machine = program_output("dpkg", "--print-architecture")
        if fields["Architecture"] != machine:
            raise UpgradeError(f"{path}: built for {fields['Architecture']}, but this machine is {machine}")
        size = fields["Installed-Size"]
        try:
            return cls(path.resolve(), checked_version(fields["Version"]), int(size) * 1024 if size.isdecimal() else 0)
        except ConfigError as error:
            raise UpgradeError(f"{path}: {error}") from error

    def unpack(self, releases: Releases) -> Path:
        """Unpack the release beside the others; it gets its name only when it is complete.

        Raises UpgradeError: disk full, damaged, or without a release of its own version."""
        free = free_bytes(releases.root)
        if free < ROOM * self.size:
            raise UpgradeError(
                f"{releases.root}: {free / 1e6:.0f} MB free, {ROOM * self.size / 1e6:.0f} MB are needed: free "
                "some space"
            )
        partial = releases.root / ".unpacked"
        shutil.rmtree(partial, ignore_errors=True)
        try:
            program_output("dpkg-deb", "--extract", str(self.path), str(partial))
            found = partial / "opt/ltm/releases" / self.version
            if not (found / "bin/ltm").is_file():
                raise UpgradeError(f"{self.path}: contains no release {self.version}")
            target = releases.folder(self.version)
            if target.exists():
                shutil.rmtree(target)
            os.utime(found)  # time of installation, not of the build
            os.sync()
            found.rename(target)
            return target
        finally:
            shutil.rmtree(partial, ignore_errors=True)


def program_output(*command: str, check: bool = True, timeout_s: float = 900.0, **options: Any) -> str:
    """Run a program of the system; return its output. `options`: of `subprocess.run`. Raises UpgradeError, unless only
    its exit code is not 0 and `check` is false."""
    shown = " ".join(command)
    try:
        ran: subprocess.CompletedProcess[str] = subprocess.run(  # nosec B603 # no shell
            command, capture_output=True, text=True, errors="replace", timeout=timeout_s, **options
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        remedy = ": a tower needs Debian or a derivative with systemd" * isinstance(error, FileNotFoundError)
        raise UpgradeError(f"{shown}: {error}{remedy}") from error
    if check and ran.returncode:
        lines = [line for line in (ran.stdout + ran.stderr).splitlines() if line.strip()]
        raise UpgradeError(f"{shown}: {'; '.join(lines[-3:]) or f'exit code {ran.returncode}'}")
    return ran.stdout.strip()
