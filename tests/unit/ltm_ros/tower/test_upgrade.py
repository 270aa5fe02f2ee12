import os
import re
import shutil
import sqlite3
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest
from scenes.tower import Tower, frames_of, write_package, write_store

from ltm_core.base.errors import ConfigError, StoreError
from ltm_core.geometry.grid import GridGeometry
from ltm_core.storage.tile_store import TileStore
from ltm_core.storage.tile_store_schema import Field, StoreSchema
from ltm_ros.tower.releases import Trial, UpgradeError
from ltm_ros.tower.store_copy import ServiceState, copy_stores, return_stores

pytestmark = pytest.mark.skipif(shutil.which("dpkg-deb") is None, reason="needs dpkg-deb: apt install dpkg")
GUARD = Path(__file__).parents[4] / "packaging/systemd/release-guard"


@pytest.fixture
def tower(tmp_path: Path) -> Tower:
    return Tower(tmp_path)


def test_a_good_release_is_asked_then_run(tower: Tower, tmp_path: Path) -> None:
    tower.install(write_package(tmp_path, "2.0"))
    assert tower.releases.current == "2.0"
    assert tower.releases.installed == ["1.0", "2.0"]
    questions = [line.partition("/releases/2.0/bin/")[2] for line in tower.asked.splitlines()]
    site = tower.places.site
    assert questions == ["ltm doctor", f"ltm check {site}", f"python -m ltm_ros.launching.kernels {site}"]
    assert tower.service.did == ["stop", "start 2.0"]
    assert tower.releases.trial is None
    (copy,) = tower.places.copies.iterdir()
    assert frames_of(copy / "fuel_map.ltm") == 5
    assert copy.name.endswith("-1.0")

    tower.upgrade.go_back()
    assert tower.releases.current == "1.0"
    assert tower.service.did[2:] == ["stop", "start 1.0"]


@pytest.mark.parametrize("question", ["doctor", "check", "launching.kernels"])
def test_a_release_that_finds_something_wrong_changes_nothing(tower: Tower, tmp_path: Path, question: str) -> None:
    with pytest.raises(UpgradeError, match=f"{question}: not as it should be; nothing was changed"):
        tower.install(write_package(tmp_path, "2.0", refuses=question))
    assert (tower.releases.current, tower.service.did) == ("1.0", [])
    assert tower.releases.installed == ["1.0"], "it is nothing to return to"


@pytest.mark.parametrize(
    ("state", "why"),
    [
        (ServiceState(False, True, "exit-code, exit code 1"), "exit-code, exit code 1"),
        (ServiceState(False, False, "starting; 2 of 3 processes run"), r"not ready within 0 s \(starting; 2 of 3"),
    ],
)
def test_a_release_that_does_not_come_up_is_taken_back(
    tower: Tower, tmp_path: Path, state: ServiceState, why: str
) -> None:
    tower.service.behaviour["2.0"] = state
    with pytest.raises(UpgradeError, match=f"2.0 was rejected: {why}.*; 1.0 runs again"):
        tower.install(write_package(tmp_path, "2.0"))
    assert tower.releases.current == "1.0"
    assert tower.service.did == ["stop", "start 2.0", "stop", "start 1.0"]
    assert tower.releases.trial is None
    assert frames_of(tower.store) == 5
    with pytest.raises(ConfigError, match="no other release to return to"):
        tower.upgrade.go_back()


def test_a_store_whose_schema_moved_forward_is_put_aside_and_the_copy_returns(tower: Tower, tmp_path: Path) -> None:
    def migrates(version: str) -> None:
        if version == "2.0":
            with sqlite3.connect(tower.store) as db:
                db.execute("ALTER TABLE frames ADD COLUMN quality REAL")
            write_store(tower.store.with_name("terrain.sqlite"), 2)

    tower.service.behaviour["2.0"] = ServiceState(False, True, "")
    tower.service.on_start = migrates
    with pytest.raises(UpgradeError):
        tower.install(write_package(tmp_path, "2.0"))
    with sqlite3.connect(tower.store) as db:
        assert len(db.execute("PRAGMA table_info(frames)").fetchall()) == 1
    assert frames_of(tower.places.copies.parent / "stores-of-2.0/fuel_map.ltm") == 5
    assert any("had changed its schema" in line for line in tower.said)


def test_a_map_whose_tiles_have_grown_fields_is_put_aside_for_a_release_that_does_not_know_them(tmp_path: Path) -> None:
    """SQLite's tables are the same then, and still the former release could not open it."""
    state, aside = tmp_path / "state", tmp_path / "aside"
    state.mkdir()
    grid = GridGeometry(0.0, 60.0, 30.0, 3, 2, "EPSG:32611")
    former = StoreSchema("map", 1, grid, 2, {"seen": Field("f4")})
    grown = StoreSchema("map", 2, grid, 2, {"seen": Field("f4"), "hidden": Field("f4")})
    TileStore.open(state / "map.ltm", former).close()
    copy = copy_stores(state, tmp_path / "copies", "1.0")
    assert copy is not None
    assert return_stores(state, copy, aside) == []
    (state / "map.ltm").unlink()
    TileStore.open(state / "map.ltm", grown).close()
    assert return_stores(state, copy, aside) == [copy / "map.ltm"]
    TileStore.open(state / "map.ltm", former).close()
    TileStore.open(aside / "map.ltm", grown).close()


def moved_forward(folder: Path) -> tuple[Path, Path]:
    """A state folder whose store has another schema than its copy; and the copy."""
    state = folder / "state"
    state.mkdir()
    write_store(state / "fuel_map.ltm", 5)
    copy = copy_stores(state, folder / "copies", "1.0")
    assert copy is not None
    with sqlite3.connect(state / "fuel_map.ltm") as db:
        db.execute("ALTER TABLE frames ADD COLUMN quality REAL")
    return state, copy


def test_what_the_service_s_user_lays_in_the_way_leads_root_nowhere(tmp_path: Path) -> None:
    """Root writes, and gives away, what it finds by name in folders of the user who reads what cameras send."""
    state, copy = moved_forward(tmp_path)
    (tmp_path / "shadow").write_text("secret")
    (state / ".fuel_map.ltm.returned").symlink_to(tmp_path / "shadow")
    assert return_stores(state, copy, tmp_path / "aside") == [copy / "fuel_map.ltm"]
    assert (tmp_path / "shadow").read_text() == "secret"
    assert frames_of(state / "fuel_map.ltm") == 5
    assert not (state / "fuel_map.ltm").is_symlink()


def test_folders_that_are_links_are_not_tidied_nor_filled(tmp_path: Path) -> None:
    state, copy = moved_forward(tmp_path)
    etc = tmp_path / "etc"
    etc.mkdir()
    for name in ("apt", "dpkg", "ssh", "ssl", "systemd"):
        (etc / name).mkdir()
    for name in ("elsewhere", "aside"):
        (tmp_path / name).symlink_to(etc)
    with pytest.raises(StoreError, match="a link, or a folder of another user"):
        copy_stores(state, tmp_path / "elsewhere", "1.0")
    with pytest.raises(StoreError, match="cannot restore"):
        return_stores(state, copy, tmp_path / "aside")
    assert sorted(path.name for path in etc.iterdir()) == ["apt", "dpkg", "ssh", "ssl", "systemd"]
    assert (state / "fuel_map.ltm").exists()


def test_a_store_is_back_on_the_disk_before_the_release_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a power cut could leave the former release with the newer store, which it refuses."""
    state, copy = moved_forward(tmp_path)
    synced: list[tuple[Path, bool]] = []
    fsync = os.fsync

    def noted(descriptor: int) -> None:
        synced.append((Path(f"/proc/self/fd/{descriptor}").readlink(), (state / "fuel_map.ltm").exists()))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    return_stores(state, copy, tmp_path / "aside")
    assert (state, True) in synced
    assert (tmp_path / "aside", True) in synced


@pytest.mark.parametrize("gone", [True, False])
def test_a_copy_that_cannot_be_put_back_does_not_keep_the_former_release_from_starting(
    tower: Tower, tmp_path: Path, gone: bool
) -> None:
    """Else the tower would stand still for good: `rollback --unconfirmed` would fail at each start."""

    def migrates(version: str) -> None:
        if version == "2.0":
            with sqlite3.connect(tower.store) as db:
                db.execute("ALTER TABLE frames ADD COLUMN quality REAL")
            if gone:
                shutil.rmtree(tower.places.copies)
            else:
                tower.store.with_name(".fuel_map.ltm.returned").mkdir()  # in the way, as on a disk that is full

    tower.service.behaviour["2.0"] = ServiceState(False, True, "")
    tower.service.on_start = migrates
    with pytest.raises(UpgradeError, match=r"1\.0 runs again"):
        tower.install(write_package(tmp_path, "2.0"))
    assert tower.releases.current == "1.0"
    assert tower.releases.trial is None
    assert tower.service.did[-1] == "start 1.0"
    (said,) = [line for line in tower.said if "starts without the missing stores" in line]
    assert ("does not exist" if gone else "cannot restore fuel_map.ltm (Is a directory)") in said
    kept = tower.store if gone else tower.places.copies.parent / "stores-of-2.0/fuel_map.ltm"
    assert frames_of(kept) == 5, "nothing is deleted"
    assert tower.store.exists() == gone


def test_a_release_that_cannot_be_stopped_in_order_is_taken_back_all_the_same(tower: Tower, tmp_path: Path) -> None:
    def refuses(version: str) -> None:
        if version == "2.0":
            raise UpgradeError("systemctl stop: timed out")

    tower.service.behaviour["2.0"] = ServiceState(False, False, "starting")
    tower.service.on_stop = refuses
    with pytest.raises(UpgradeError, match=r"not ready within .*; 1\.0 runs again"):
        tower.install(write_package(tmp_path, "2.0"))
    assert (tower.releases.current, tower.releases.trial) == ("1.0", None)
    assert tower.service.did == ["stop", "start 2.0", "stop", "start 1.0"]
    assert "2.0 cannot be stopped in order (systemctl stop: timed out)" in tower.said


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError("No space left on device")])
def test_a_way_back_that_is_cut_short_leaves_a_service_that_is_started(
    tower: Tower, tmp_path: Path, error: BaseException
) -> None:
    """Its start finds the trial, and returns."""

    def cut_short(version: str) -> None:
        if version == "2.0":
            raise error

    tower.service.behaviour["2.0"] = ServiceState(False, True, "")
    tower.service.on_stop = cut_short
    with pytest.raises(type(error)):
        tower.install(write_package(tmp_path, "2.0"))
    assert tower.service.did == ["stop", "start 2.0", "stop", "start 2.0"]
    assert tower.releases.trial is not None
    assert tower.upgrade.return_unconfirmed() == tower.releases.current == "1.0"


def test_what_is_no_package_of_ours_is_refused(tower: Tower, tmp_path: Path) -> None:
    with pytest.raises(UpgradeError, match="package 'other', expected 'ltm'"):
        tower.install(write_package(tmp_path, "2.0", name="other"))
    with pytest.raises(UpgradeError, match="for m68k, but this machine is"):
        tower.install(write_package(tmp_path, "2.1", machine="m68k"))
    junk = tmp_path / "junk.deb"
    junk.write_bytes(b"!<arch>\njunk")
    with pytest.raises(UpgradeError, match=r"junk\.deb"):
        tower.install(junk)
    with pytest.raises(UpgradeError, match="no such file"):
        tower.install(tmp_path / "none.deb")
    with pytest.raises(UpgradeError, match=r"release 1\.0 is running already"):
        tower.install(write_package(tmp_path, "1.0"))
    assert (tower.releases.current, tower.service.did) == ("1.0", [])


def test_there_must_be_something_to_return_to(tower: Tower, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no other release to return to"):
        tower.upgrade.go_back()
    with pytest.raises(ConfigError, match=r"no release 7\.0 in"):
        tower.upgrade.go_back("7.0")
    with pytest.raises(ConfigError, match="expected letters"):
        tower.upgrade.go_back("../../etc")


@dataclass
class Guard:
    """The guard's script over a tower in a folder, with programs of systemd that write down what they are asked."""

    tower: Tower
    folder: Path

    def __post_init__(self) -> None:
        self.folder.mkdir()
        for name in ("systemctl", "systemd-run"):
            program = self.folder / name
            program.write_text(
                f'#!/bin/sh\necho "{name} $*" >> "{self.folder}/did"\n'
                f'case "$*" in\n'
                f'show*ActiveState*) cat "{self.folder}/state" ;;\n'
                f'show*) cat "{self.folder}/exit" ;;\n'
                f"esac\n"
            )
            program.chmod(0o755)
        (self.folder / "guard").write_text(GUARD.read_text().replace("/opt/ltm", str(self.tower.releases.root)))

    def runs(self, *arguments: str, state: str = "inactive", status: int = 0) -> list[str]:
        """What it asks systemd for, where the service is in that state, and has ended with that exit status."""
        (self.folder / "state").write_text(state)
        (self.folder / "exit").write_text(str(status))
        (self.folder / "did").write_text("")
        path = f"{self.folder}:{os.environ['PATH']}"
        subprocess.run(["sh", str(self.folder / "guard"), *arguments], check=True, env={"PATH": path})
        return [line for line in (self.folder / "did").read_text().splitlines() if " show " not in line]


def test_the_guard_lets_a_release_start_once_and_then_asks_the_former_one_to_return(
    tower: Tower, tmp_path: Path
) -> None:
    """As after a crash, or a power cut in the midst of an upgrade: nobody waits for READY any more."""
    tower.install(write_package(tmp_path, "2.0"))
    guard = Guard(tower, tmp_path / "systemd")
    begun = tower.asked

    def start() -> str:
        guard.runs()
        return tower.asked.removeprefix(begun)

    assert start() == start() == "", "nothing is on trial"
    tower.releases.begin_trial(Trial("1.0", "2.0", "", 600))
    assert start() == "", "its first start"
    assert re.fullmatch(r".*/releases/1\.0/bin/ltm rollback --unconfirmed\n", start())
    assert tower.upgrade.return_unconfirmed() == "1.0"
    assert tower.releases.current == "1.0"
    assert tower.upgrade.return_unconfirmed() is None
    assert not (tower.releases.root / "trial").exists()


def test_frames_that_the_failed_release_kept_stay_where_it_changed_no_schema(tower: Tower, tmp_path: Path) -> None:
    tower.service.behaviour["2.0"] = ServiceState(False, True, "")
    tower.service.on_start = lambda version: write_store(tower.store, 3) if version == "2.0" else None
    with pytest.raises(UpgradeError):
        tower.install(write_package(tmp_path, "2.0"))
    assert frames_of(tower.store) == 8


@pytest.mark.parametrize(
    ("error", "why"),
    [(UpgradeError("systemctl start: no"), "systemctl start: no"), (KeyboardInterrupt(), "interrupted")],
)
def test_a_start_that_fails_or_is_interrupted_brings_the_former_release_back(
    tower: Tower, tmp_path: Path, error: BaseException, why: str
) -> None:
    def fails(version: str) -> None:
        if version == "2.0":
            raise error

    tower.service.on_start = fails
    with pytest.raises(UpgradeError, match=rf"2\.0 was rejected: {why}; 1\.0 runs again"):
        tower.install(write_package(tmp_path, "2.0"))
    assert (tower.releases.current, tower.releases.trial) == ("1.0", None)
    assert tower.releases.installed == ["1.0"]


def test_a_trial_whose_former_release_is_gone_does_not_keep_the_tower_from_starting(
    tower: Tower, tmp_path: Path
) -> None:
    """Else the service's start would fail every ten seconds, for good."""
    tower.install(write_package(tmp_path, "2.0"))
    guard = Guard(tower, tmp_path / "systemd")
    tower.releases.begin_trial(Trial("1.0", "2.0", "", 600))
    guard.runs()
    shutil.rmtree(tower.releases.folder("1.0"))
    assert guard.runs() == []
    assert tower.releases.trial is None
    assert tower.releases.current == "2.0"


def test_where_nobody_watches_a_trial_the_guard_ends_it(tower: Tower, tmp_path: Path) -> None:
    """After a power cut, or where the upgrade was killed: a release that never gets ready is not started a second time
    by itself, for its runner asks systemd for more time without end."""
    guard = Guard(tower, tmp_path / "systemd")
    assert guard.runs() == guard.runs("late", state="activating") == [], "nothing is on trial"
    tower.releases.begin_trial(Trial("1.0", "2.0", "", 420))
    assert tower.releases.trial == Trial("1.0", "2.0", "", 420)
    stops, arms = guard.runs()
    assert stops == "systemctl stop ltm-trial.timer"
    assert re.fullmatch(r"systemd-run .*--unit=ltm-trial --on-active=420 \S+/release-guard late", arms)
    assert guard.runs("late") == [], "somebody has stopped it"
    assert guard.runs("late", state="failed") == [], "it had to be killed"
    restarts = ["systemctl restart --no-block ltm.service"]
    assert guard.runs("late", state="failed", status=78) == restarts, "it refuses the site file"
    assert guard.runs("late", state="activating") == restarts
    assert tower.releases.trial is not None, "the second start returns"
    assert guard.runs("late", state="active") == []
    assert not (tower.releases.root / "trial").exists(), "it is ready: taken"
