"""Boot a Debian machine with systemd in namespaces of this machine, without a network, to test a package.

An overlay over a root folder (`make_debian_root`) gives each trial the same clean system. This needs root and a Linux
with overlays and control groups, and changes nothing on this machine.
"""

import os
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

PACKAGES = "python3,systemd"
BOOT = r"""
set -e
mount --make-rprivate /
mount -t overlay overlay -o "lowerdir=$LOWER,upperdir=$WORK/upper,workdir=$WORK/work" "$WORK/root"
cd "$WORK/root"
mount -t proc proc proc
mount -t sysfs -o ro sysfs sys
mount -t tmpfs -o mode=755 tmpfs sys/fs/cgroup
if mountpoint -q /sys/fs/cgroup && [ "$(stat -f -c %T /sys/fs/cgroup)" = cgroup2fs ]; then
    umount sys/fs/cgroup; mount -t cgroup2 cgroup2 sys/fs/cgroup
else
    mkdir sys/fs/cgroup/unified sys/fs/cgroup/systemd
    mount -t cgroup2 cgroup2 sys/fs/cgroup/unified
    mount -t cgroup -o none,name=systemd cgroup sys/fs/cgroup/systemd
fi
mount -t tmpfs -o mode=755 tmpfs dev
for name in null zero full random urandom tty; do touch "dev/$name"; mount --bind "/dev/$name" "dev/$name"; done
mkdir dev/shm dev/pts
mount -t tmpfs tmpfs dev/shm
mount -t devpts -o newinstance,ptmxmode=0666 devpts dev/pts
ln -s pts/ptmx dev/ptmx; ln -s /proc/self/fd dev/fd
touch dev/console; mount --bind "$WORK/console" dev/console
mount -t tmpfs -o mode=755 tmpfs run
mount -t tmpfs tmpfs tmp
mkdir -p opt/trial; mount --bind "$SHARED" opt/trial
ip link set lo up 2>/dev/null || true
export container=trial
# Not chroot: in one, no service could have users of its own.
mkdir -p mnt/former; pivot_root . mnt/former; cd /; umount --lazy /mnt/former; rmdir /mnt/former
exec /lib/systemd/systemd --log-target=console
"""


class TrialError(RuntimeError):
    """The machine cannot be booted here, or a command on it failed."""


def make_debian_root(folder: Path, suite: str = "bookworm") -> None:
    """Install a minimal Debian in `folder` from its package servers, if it is missing. Raises TrialError."""
    if (folder / "lib/systemd/systemd").exists():
        return
    program = shutil.which("debootstrap")
    if program is None:
        raise TrialError("needs debootstrap: apt install debootstrap")
    folder.mkdir(parents=True, exist_ok=True)
    command = [program, "--variant=minbase", f"--include={PACKAGES}", suite, str(folder)]
    ran = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if ran.returncode:
        raise TrialError(f"debootstrap: {ran.stdout.splitlines()[-1] if ran.stdout else ran.returncode}")


class TrialMachine:
    """Context manager that boots a machine, and ends it. `shared`: folder mounted there at /opt/trial."""

    def __init__(self, lower: Path, shared: Path) -> None:
        if os.geteuid() != 0:
            raise TrialError("needs root, for namespaces and an overlay")
        self._lower, self._shared = lower.resolve(), shared.resolve()
        self._work = Path()
        self._machine: subprocess.Popen[bytes] | None = None
        self._init = 0

    def __enter__(self) -> "TrialMachine":
        # Not in /tmp: that may be an overlay itself, or memory.
        self._work = Path(tempfile.mkdtemp(prefix="ltm-trial-", dir="/var/tmp"))
        for name in ("upper", "work", "root"):
            (self._work / name).mkdir()
        (self._work / "upper").chmod(0o755)
        (self._work / "console").touch()
        spaces = [f"--{name}" for name in ("mount", "net", "pid", "ipc", "uts", "cgroup")]
        self._machine = subprocess.Popen(
            # The machine ends with this program, even if it is killed.
            ["setpriv", "--pdeathsig=KILL", "unshare", *spaces, "--fork", "--kill-child", "/bin/bash", "-c", BOOT],
            env=os.environ | {"LOWER": str(self._lower), "WORK": str(self._work), "SHARED": str(self._shared)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            self._wait_for_boot()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        if self._machine is not None:
            # Its init and all its processes end with `unshare`.
            self._machine.send_signal(signal.SIGKILL)
            self._machine.wait()
        shutil.rmtree(self._work, ignore_errors=True)

    def run(self, command: str, *, check: bool = True, timeout_s: float = 900.0) -> subprocess.CompletedProcess[str]:
        """Run a shell command on the machine. Raises TrialError with its output if it fails and `check` is true, if it
        takes longer than `timeout_s`, or if the machine has ended."""
        enter = ["nsenter", f"--target={self._init}", *(f"--{n}" for n in ("mount", "net", "pid", "ipc", "uts"))]
        enter += ["--cgroup", "--root", "--wd"]
        environment = {
            "PATH": "/usr/sbin:/usr/bin:/sbin:/bin",
            "HOME": "/root",
            "LC_ALL": "C.UTF-8",
            "DEBIAN_FRONTEND": "noninteractive",
        }
        try:
            ran = subprocess.run(
                [*enter, "/bin/sh", "-c", command],
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                timeout=timeout_s,
            )
        except subprocess.TimeoutExpired as error:
            raise TrialError(f"{command}: not done after {timeout_s:.0f} s") from error
        if self._machine is None or self._machine.poll() is not None:
            # Otherwise later commands would look like failures of the package.
            raise TrialError(f"{command}: the machine has ended: it was killed\n{ran.stdout[-1000:]}")
        if check and ran.returncode:
            raise TrialError(f"{command}: exit code {ran.returncode}\n{ran.stdout[-4000:]}")
        return ran

    def says(self, command: str) -> str:
        """Return the output of a command with any exit code."""
        return self.run(command, check=False).stdout.strip()

    def wait_for(self, command: str, wanted: str, timeout_s: float) -> float:
        """Wait until `command` prints `wanted`; return the seconds. Raises TrialError."""
        begun = time.monotonic()
        while (said := self.says(command)) != wanted:
            if time.monotonic() - begun > timeout_s:
                raise TrialError(f"{command}: {said!r}, not {wanted!r}, after {timeout_s:.0f} s")
            time.sleep(0.5)
        return time.monotonic() - begun

    def _wait_for_boot(self) -> None:
        assert self._machine is not None
        children = Path(f"/proc/{self._machine.pid}/task/{self._machine.pid}/children")
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            if self._machine.poll() is not None:
                said = self._machine.stdout.read().decode(errors="replace") if self._machine.stdout else ""
                raise TrialError(f"cannot be booted here: {said.strip()[-500:]}")
            if numbers := children.read_text().split():
                self._init = int(numbers[0])
                state = self.says("systemctl is-system-running") if self._is_systemd() else ""
                if state in ("running", "degraded"):
                    return
            time.sleep(0.2)
        raise TrialError(f"systemd has not booted within 60 s: {(self._work / 'console').read_text()[-500:]}")

    def _is_systemd(self) -> bool:
        return Path(f"/proc/{self._init}/comm").read_text().strip() == "systemd"
