"""List installed releases, and unpack the release of a Debian package beside them."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess  # nosec B404 # argument lists, no shell
from dataclasses import dataclass
from pathlib import Path

from ltm_core.base.errors import ConfigError, LtmError

ROOT = Path("/opt/ltm")
_VERSION = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+~-]*")


def checked_version(version: str) -> str:
    """A name that is one folder. Raises ConfigError."""
    if not _VERSION.fullmatch(version):
        raise ConfigError(f"version {version!r}: expected letters, digits and . + ~ - as Debian has them")
    return version


@dataclass(frozen=True)
class Trial:
    """A release that was switched to and has not been confirmed: `former` returns where it fails."""

    former: str
    candidate: str
    copy: str
    """Folder with the copy of the stores as `former` left them; empty: there was none."""
    watched_s: int
    """From its first start on, after which nobody watches any more whether it gets ready: then the guard looks."""


class Releases:
    """`ROOT/releases/VERSION`, each whole in itself; `ROOT/current` is a link to one.

    A trial outlives a power cut: `ROOT/trial` names it, and the service's start looks there first
    (`packaging/systemd/release-guard`).
    """

    def __init__(self, root: Path = ROOT) -> None:
        self.root = root
        self._folder = root / "releases"
        self._trial = root / "trial"

    @property
    def current(self) -> str:
        """Raises ConfigError where this is no installed tower."""
        link = self.root / "current"
        try:
            return link.readlink().name
        except OSError as error:
            raise ConfigError(
                f"{link}: {error.strerror}: upgrades and returns are for a tower that was installed from the package "
                "(docs/deployment.md)"
            ) from error

    @property
    def installed(self) -> list[str]:
        """In the order in which they were unpacked."""
        folders = [path for path in self._folder.iterdir() if path.is_dir() and not path.name.startswith(".")]
        return [path.name for path in sorted(folders, key=lambda path: (path.stat().st_mtime, path.name))]

    def folder(self, version: str) -> Path:
        return self._folder / checked_version(version)

    def program(self, version: str) -> Path:
        """Raises ConfigError naming the releases there are."""
        program = self.folder(version) / "bin/ltm"
        if not program.exists():
            raise ConfigError(f"no release {version} in {self._folder}; there are {', '.join(self.installed)}")
        return program

    def other(self) -> str:
        """The release to return to: the one that ran before, else the newest beside the current one.

        Raises ConfigError where there is none.
        """
        others = [version for version in self.installed if version != self.current]
        if not others:
            raise ConfigError(f"{self._folder} holds no release but {self.current}: there is nothing to return to")
        link = self.root / "former"
        ran = link.readlink().name if link.is_symlink() else ""
        return ran if ran in others else others[-1]

    def switch(self, version: str) -> None:
        """In one step: after a power cut one or the other is current. Raises ConfigError."""
        self.program(version)
        former = self.current
        if former != version:
            self._link("former", former)
        self._link("current", version)
        _sync(self.root)

    def _link(self, name: str, version: str) -> None:
        link = self.root / f".{name}.new"
        link.unlink(missing_ok=True)
        link.symlink_to(Path("releases") / version)
        link.replace(self.root / name)

    def remove(self, version: str) -> None:
        """Forget a release that does not run."""
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
        """Before the switch: from here on a second start of the service is one too many."""
        self.end_trial()
        self._trial.mkdir(mode=0o755)
        partial = self._trial / ".release"
        lines = trial.former, trial.candidate, trial.copy, trial.watched_s
        partial.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
        with partial.open("rb") as file:
            os.fsync(file.fileno())
        partial.rename(self._trial / "release")
        _sync(self._trial)

    def end_trial(self) -> None:
        for name in ("release", ".release", "started"):
            (self._trial / name).unlink(missing_ok=True)
        with contextlib.suppress(FileNotFoundError):
            self._trial.rmdir()
        _sync(self.root)


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


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
