"""An installed tower in a folder: releases of small shell programs, a store, and a service that runs on paper."""

import contextlib
import sqlite3
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from ltm_ros.tower.releases import PackageFile, Releases
from ltm_ros.tower.store_copy import ServiceState, SystemdService
from ltm_ros.tower.upgrade import Places, Upgrade

CONTROL = """Package: {name}
Version: {version}
Architecture: {machine}
Maintainer: nobody
Installed-Size: 4
Description: -
"""


def write_release(folder: Path, refuses: str = "") -> None:
    """`refuses`: the word in a question that it answers with an error."""
    (folder / "bin").mkdir(parents=True)
    for name in ("ltm", "python"):
        program = folder / "bin" / name
        program.write_text('#!/bin/sh\necho "$0 $*" >> "$(dirname "$0")/../../asked"\n')
        if refuses:
            with program.open("a") as script:
                script.write(f'case "$*" in *{refuses}*) echo "{refuses}: not as it should be"; exit 1 ;; esac\n')
        program.chmod(0o755)


def write_package(folder: Path, version: str, *, name: str = "ltm", machine: str = "", refuses: str = "") -> Path:
    """A Debian package of a release, made by dpkg-deb."""
    root = folder / f"root-{version}"
    write_release(root / f"opt/ltm/releases/{version}", refuses)
    (root / "DEBIAN").mkdir()
    machine = machine or subprocess.check_output(["dpkg", "--print-architecture"], text=True).strip()
    (root / "DEBIAN/control").write_text(CONTROL.format(name=name, version=version, machine=machine))
    package = folder / f"ltm_{version}.deb"
    subprocess.run(["dpkg-deb", "--build", root, package], check=True, capture_output=True)
    return package


def write_store(path: Path, frames: int, version: int = 1) -> None:
    """As a node leaves it that was killed: content in the write-ahead log."""
    with contextlib.closing(sqlite3.connect(path)) as db:
        db.execute("PRAGMA journal_mode = WAL")
        db.execute(f"PRAGMA user_version = {version}")
        db.execute("CREATE TABLE IF NOT EXISTS frames (stamp_ns INTEGER)")
        db.executemany("INSERT INTO frames VALUES (?)", [(number,) for number in range(frames)])
        db.commit()


def frames_of(path: Path) -> int:
    with contextlib.closing(sqlite3.connect(path)) as db:
        (count,) = db.execute("SELECT count(*) FROM frames").fetchone()
        return int(count)


@dataclass
class PaperService(SystemdService):
    """Starts what is current; `behaviour` says of each release what becomes of it."""

    releases: Releases
    behaviour: dict[str, ServiceState] = field(default_factory=dict)
    on_start: Callable[[str], None] = lambda version: None
    on_stop: Callable[[str], None] = lambda version: None
    did: list[str] = field(default_factory=list)

    def stop(self) -> None:
        self.did.append("stop")
        self.on_stop(self.releases.current)

    def start(self) -> None:
        version = self.releases.current
        self.did.append(f"start {version}")
        self.on_start(version)

    def state(self) -> ServiceState:
        return self.behaviour.get(self.releases.current, ServiceState(True, False, "all 3 processes run"))


class Tower:
    def __init__(self, folder: Path) -> None:
        self.releases = Releases(folder / "opt")
        write_release(folder / "opt/releases/1.0")
        (folder / "opt/current").symlink_to("releases/1.0")
        self.places = Places(folder / "site.yaml", folder / "lib/state", folder / "lib/copies", user="no-such-user")
        self.places.state.mkdir(parents=True)
        self.store = self.places.state / "fuel_map.ltm"
        write_store(self.store, 5)
        self.service = PaperService(self.releases)
        self.said: list[str] = []
        self.upgrade = Upgrade(self.releases, self.service, self.places, self.said.append, ready_s=0.2)

    @property
    def asked(self) -> str:
        """All questions to releases, in order."""
        return (self.releases.root / "releases/asked").read_text()

    def install(self, package: Path) -> None:
        self.upgrade.install(PackageFile.open(package))
