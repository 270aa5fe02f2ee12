"""Test the package on a clean Debian with systemd, and print the result of each check: `make try-deb`.

`python3 packaging/try_deb.py PACKAGE.deb` as root: install without a network, start the service with the demo's site
(no camera sends), kill a node, stop the runner, upgrade, roll back, upgrade to broken releases, remove and purge. The
other releases are copies of the package with other versions, some of them broken on purpose.
"""

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from trial_machine import TrialError, TrialMachine, make_debian_root

REPOSITORY = Path(__file__).resolve().parents[1]
SHOW = "systemctl show ltm --value --property"
LOOPBACK_9464 = "0100007F:24F8"
"""127.0.0.1:9464 in the format of /proc/net/tcp."""
BROKEN = {
    "never gets ready": {"ltm_ros/launching/site_process.py": "import time\ntime.sleep(1e6)\n"},
    "crashes": {"ltm_ros/launching/runner.py": "raise RuntimeError('a broken build')\n"},
    "its own doctor refuses": {"ltm_ros/tower/doctor.py": "raise RuntimeError('a broken build')\n"},
}
"""Releases that must be rejected: modules, and what they are replaced by."""
WATCHED_S = {"never gets ready": 60, "crashes": 600}
"""Seconds until the guard checks a release that a power cut leaves on trial; the second does not need it."""
BACK_S = 180
"""Seconds from the stop of a release until it is ready again, after the new one was rejected."""
RELEASES = "ls /opt/ltm/releases"
CURRENT = "readlink /opt/ltm/current"
PROCESSES = "for p in /proc/[0-9]*; do grep -qas '[l]tm_ros' $p/cmdline && stat -c %U $p; done | sort -u"
"""Command that prints the owners of our processes."""
READY_S = 900.0
"""Seconds to wait for the first start."""
FIRST_READY_S = 20.0
"""Maximum seconds until the first start is ready; the package contains compiled kernels."""
UPGRADE_S = 3600.0
"""Maximum seconds for an upgrade with its checks on a busy machine."""
STAGES = ("running", "upgrade", "broken", "removed")
"""Choices of `--only`, in their order. Each needs the installed package, and all but the last a started service."""


class Trial:
    """Prints each requirement with its result; `failed` counts the failures."""

    def __init__(self) -> None:
        self.failed = 0
        self._begun = time.monotonic()

    def holds(self, what: str, fact: bool, found: object = "") -> None:
        self.failed += not fact
        mark = "holds " if fact else "FAILS "
        print(
            f"[{time.monotonic() - self._begun:5.0f} s] {mark} {what}{f': {found}' if str(found) else ''}", flush=True
        )


def put_site(machine: TrialMachine) -> None:
    """Install the demo's site."""
    machine.run(
        "cp /opt/trial/demo/*.tif /opt/trial/demo/site.yaml /etc/ltm/ && chmod 644 /etc/ltm/*.tif /etc/ltm/*.yaml"
    )
    machine.run("printf 'health: {}\\n' >> /etc/ltm/site.yaml")


def why(machine: TrialMachine) -> str:
    return machine.says("systemctl status ltm --no-pager --lines 0; journalctl --namespace=ltm -n 60 --no-pager")


def installed(machine: TrialMachine, trial: Trial, package: str) -> None:
    begun = time.monotonic()
    machine.run(f"dpkg --install /opt/trial/{package}")
    trial.holds("installs without a network", True, f"{time.monotonic() - begun:.0f} s")
    trial.holds("the files are as packaged", machine.says("dpkg --verify ltm") == "", machine.says("dpkg --verify ltm"))
    user = machine.says("getent passwd ltm")
    trial.holds("user ltm without a shell", user.endswith("/var/lib/ltm:/usr/sbin/nologin"), user)
    trial.holds("starts at boot", machine.says("systemctl is-enabled ltm") == "enabled")
    video = machine.run("/opt/ltm/current/bin/python -c 'import av; print(av.__version__)'", check=False)
    trial.holds("video streams can be read (PyAV)", video.returncode == 0, video.stdout.strip())
    doctor = machine.run("ltm doctor", check=False)
    trial.holds("ltm doctor", doctor.returncode == 0, doctor.stdout.splitlines()[-1])


def ready(machine: TrialMachine, trial: Trial) -> bool:
    """Start the service; return whether it became ready."""
    machine.run("systemctl reset-failed ltm; systemctl start --no-block ltm")
    try:
        took_s = machine.wait_for(f"{SHOW} ActiveState", "active", READY_S)
    except TrialError as error:
        trial.holds("is ready", False, f"{error}\n{why(machine)}")
        return False
    took = f"{took_s:.0f} s; {machine.says(f'{SHOW} StatusText')}"
    trial.holds(f"is ready within {FIRST_READY_S:.0f} s of its first start", took_s <= FIRST_READY_S, took)
    compiled = machine.says("journalctl --namespace=ltm --no-pager | grep -c 'compiling the kernels'")
    trial.holds("compiles no kernels", compiled == "0", compiled)
    return True


def started(machine: TrialMachine, trial: Trial) -> None:
    template = machine.run("systemctl start ltm", check=False).returncode
    trial.holds(
        "a site that is not filled in is refused, and not tried again",
        template != 0 and machine.says(f"{SHOW} ExecMainStatus") == "78" and machine.says(f"{SHOW} NRestarts") == "0",
        machine.says(f"{SHOW} StatusText"),
    )
    put_site(machine)
    if not ready(machine, trial):
        return
    owners = machine.says(PROCESSES)
    trial.holds("runs as ltm alone", owners == "ltm", owners)
    main = machine.says(f"{SHOW} MainPID")
    caps = machine.says(f"grep CapEff /proc/{main}/status | cut -f2")
    trial.holds("without capabilities", int(caps, 16) == 0, caps)
    shm = machine.says(f"nsenter --target {main} --mount df --output=size,target /dev/shm | tail -1")
    trial.holds("a /dev/shm of its own", shm.split()[0] == str(2 << 20), f"{int(shm.split()[0]) >> 10} MiB")
    sockets = machine.says("grep -h ' 0A ' /proc/net/tcp /proc/net/tcp6 | tr -s ' ' | cut -d' ' -f3").split()
    trial.holds("of TCP sockets only health listens, on loopback", sockets == [LOOPBACK_9464], sockets)
    said = machine.says("COLUMNS=160 ltm status")
    fine = "missing" not in said and "no frame since the start" in said
    trial.holds("ltm status: all nodes report, no camera sends", fine, said.splitlines()[0])
    score = machine.says("systemd-analyze security ltm | tail -1")
    trial.holds("hardened, as systemd sees the running unit", float(score.split(":")[1].split()[0]) <= 2.0, score)
    started_as = "s/^.fuel_map. -- started as process //p"
    machine.run(f"kill -9 $(journalctl --namespace=ltm --output=cat | sed -n '{started_as}' | tail -1)")
    machine.wait_for(f"{SHOW} StatusText | grep -c 'down: fuel_map'", "1", 60)
    machine.wait_for(f"{SHOW} StatusText | grep -c 'all . processes run'", "1", 120)
    trial.holds("a killed node comes back, the service is not restarted", machine.says(f"{SHOW} NRestarts") == "0")
    trial.holds(
        "the map is kept", machine.says("ls /var/lib/ltm/state") != "", machine.says("ls /var/lib/ltm/state").split()
    )
    begun = time.monotonic()
    machine.run(f"kill -STOP {machine.says(f'{SHOW} MainPID')}")
    machine.wait_for(f"{SHOW} NRestarts", "1", 400)
    machine.wait_for(f"{SHOW} ActiveState", "active", 300)
    trial.holds(
        "a runner that hangs is restarted by the watchdog", True, f"{time.monotonic() - begun:.0f} s until ready"
    )


def changed(package: Path, version: str, target: Path, spoilt: dict[str, str] | None = None) -> Path:
    """Return a copy of the package as another version; `spoilt`: modules to replace, with their new text."""
    with tempfile.TemporaryDirectory(dir=target) as folder:
        root = Path(folder) / "root"
        subprocess.run(["dpkg-deb", "--raw-extract", package, root], check=True)
        (old,) = (root / "opt/ltm/releases").iterdir()
        new = old.rename(old.with_name(version))
        for file in (*(root / "DEBIAN").iterdir(), *(path for path in (new / "bin").iterdir() if path.is_file())):
            if not file.is_symlink():
                mode = file.stat().st_mode
                file.write_bytes(file.read_bytes().replace(old.name.encode(), version.encode()))
                file.chmod(mode)
        (site_packages,) = new.glob("lib/python3.*/site-packages")
        for name, text in (spoilt or {}).items():
            module = site_packages / name
            module.write_text(text)
            for compiled in (module.parent / "__pycache__").glob(f"{module.stem}.*.pyc"):
                compiled.unlink()
        made = target / f"ltm_{version}_amd64.deb"
        subprocess.run(["dpkg-deb", "--root-owner-group", "-Zzstd", "-z1", "--build", root, made], check=True)
        return made


def changed_and_back(machine: TrialMachine, trial: Trial, shared: Path, package: Path) -> None:
    first = machine.says(CURRENT)
    good = changed(package, "0.9+good", shared)
    begun = time.monotonic()
    said = machine.run(f"ltm upgrade /opt/trial/{good.name}", check=False, timeout_s=UPGRADE_S)
    steps = [line for line in said.stdout.splitlines() if line.startswith(("--", "ltm:"))]
    fine = said.returncode == 0 and machine.says(CURRENT) == "releases/0.9+good"
    trial.holds("an upgrade", fine, f"{time.monotonic() - begun:.0f} s\n  " + "\n  ".join(steps))
    installed = machine.says("dpkg-query --show --showformat='${Version} ${Status}' ltm")
    trial.holds("dpkg knows it", installed == "0.9+good install ok installed", installed)
    trial.holds("the former release stays", first.removeprefix("releases/") in machine.says(RELEASES))
    said = machine.run("ltm rollback", check=False)
    fine = said.returncode == 0 and machine.says(CURRENT) == first and machine.says(f"{SHOW} ActiveState") == "active"
    trial.holds("the way back", fine, said.stdout.strip().splitlines()[-2:])
    good.unlink()


def broken(machine: TrialMachine, trial: Trial, shared: Path, package: Path) -> None:
    first = machine.says(CURRENT)
    kept = machine.says(RELEASES)
    for what, spoilt in BROKEN.items():
        unfit = changed(package, "0.9+broken", shared, spoilt)
        begun = time.monotonic()
        said = machine.run(f"ltm upgrade /opt/trial/{unfit.name}", check=False, timeout_s=UPGRADE_S)
        back = machine.says(CURRENT) == first and machine.says(f"{SHOW} ActiveState") == "active"
        word = (said.stdout.strip().splitlines() or ["it says nothing"])[-1]
        took = f"{time.monotonic() - begun:.0f} s with the questions before: {word}"
        trial.holds(f"back by itself from a release: {what}", said.returncode == 1 and back, took)
        stood = [int(seconds) for seconds in re.findall(r"is ready (\d+) s after it was stopped", said.stdout)]
        if what != "its own doctor refuses":  # then the tower is not stopped at all
            trial.holds(f"within {BACK_S} s", len(stood) == 1 and stood[0] <= BACK_S, stood)
        trial.holds("nothing is on trial any more", machine.says("ls -d /opt/ltm/trial 2>/dev/null") == "")
        trial.holds(
            "nothing of it is left to return to", machine.says(RELEASES) == kept, machine.says(RELEASES).split()
        )
        if what in WATCHED_S:
            power_cut(machine, trial, first, what, unfit)
        unfit.unlink()


def power_cut(machine: TrialMachine, trial: Trial, first: str, what: str, unfit: Path) -> None:
    """Simulate a power cut during an upgrade: the release on trial is current, and `ltm upgrade` is gone."""
    former, watched_s = first.removeprefix("releases/"), WATCHED_S[what]
    machine.run(f"dpkg-deb --extract /opt/trial/{unfit.name} /opt/unpacked")
    machine.run("mv /opt/unpacked/opt/ltm/releases/0.9+broken /opt/ltm/releases/ && rm -r /opt/unpacked")
    machine.run("mkdir /opt/ltm/trial")
    machine.run(f"printf '{former}\\n0.9+broken\\n\\n{watched_s}\\n' > /opt/ltm/trial/release")
    machine.run("ln -sfnT releases/0.9+broken /opt/ltm/current; systemctl restart --no-block ltm")
    held = f"back by itself after a power cut in an upgrade to a release: {what}"
    try:
        took_s = machine.wait_for(f"{CURRENT}; {SHOW} ActiveState", f"{first}\nactive", 240 + watched_s)
        trial.holds(held, True, f"{took_s:.0f} s")
    except TrialError as error:
        trial.holds(held, False, f"{error}\n{why(machine)}")
    machine.run("rm -rf /opt/ltm/releases/0.9+broken")


def removed(machine: TrialMachine, trial: Trial) -> None:
    machine.run("dpkg --remove ltm")
    trial.holds("removed: no process is left", machine.says(PROCESSES) == "")
    kept = machine.says(
        "find /opt/ltm /usr/lib/systemd/system/ltm.service /usr/bin/ltm /var/lib/ltm/.cache 2>/dev/null"
    )
    trial.holds("removed: nothing left but state and configuration", kept == "", kept)
    trial.holds("the map stays", machine.says("ls /var/lib/ltm/state") != "")
    machine.run("dpkg --purge ltm")
    left = machine.says(
        "find / -xdev -path /proc -prune -o -path /var/lib/ltm -prune -o -name 'ltm*' -print 2>/dev/null "
        "| grep -v -e ^/tmp -e ^/opt/trial"
    )
    trial.holds("purged: nothing left but the map", left == "", left.split())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("package", type=Path)
    parser.add_argument(
        "--root",
        type=Path,
        default=REPOSITORY / "out/trial/debian",
        help="Debian's root folder, made if missing.",
    )
    parser.add_argument("--quick", action="store_true", help="Without upgrades.")
    parser.add_argument("--only", default=",".join(STAGES), help=f"Some of {','.join(STAGES)}.")
    options = parser.parse_args()
    stages = [stage for stage in options.only.split(",") if not (options.quick and stage in ("upgrade", "broken"))]
    if foreign := set(stages) - set(STAGES):
        parser.error(f"--only: {', '.join(sorted(foreign))}: there are {', '.join(STAGES)}")
    trial = Trial()
    try:
        make_debian_root(options.root)
        with tempfile.TemporaryDirectory(dir="/var/tmp") as folder:
            shared = Path(folder)
            shared.chmod(0o755)
            shutil.copy(options.package, shared)
            shutil.copytree(REPOSITORY / "bags/demo", shared / "demo", ignore=shutil.ignore_patterns("recording"))
            with TrialMachine(options.root, shared) as machine:
                trial.holds("a clean Debian boots", True, machine.says("systemctl --version | head -1"))
                installed(machine, trial, options.package.name)
                if "running" in stages:
                    started(machine, trial)
                else:
                    put_site(machine)
                    ready(machine, trial)
                if "upgrade" in stages:
                    changed_and_back(machine, trial, shared, options.package)
                if "broken" in stages:
                    broken(machine, trial, shared, options.package)
                if "removed" in stages:
                    removed(machine, trial)
    except TrialError as error:
        print(f"cannot be tested: {error}", file=sys.stderr)
        sys.exit(2)
    print(f"{trial.failed} checks failed" if trial.failed else "all checks passed")
    sys.exit(1 if trial.failed else 0)


if __name__ == "__main__":
    main()
