"""Change the release that a tower runs, and return to the previous one if the new one does not start.

Steps: unpack the release beside the others; let it check its installation and the site file and compile its kernels,
while the current release runs; stop; copy the stores; switch; start; wait for READY. A failure before the switch
changes nothing. A failure after it brings the previous release back."""

import os
import pwd
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ltm_core.base.errors import LtmError
from ltm_ros.tower.releases import PackageFile, Releases, Trial, UpgradeError, program_output
from ltm_ros.tower.store_copy import SystemdService, copy_stores, return_stores

LOOK_S = 0.5
CHECK_S = 1800.0
"""Seconds for each check by a new release; compiling its kernels takes minutes on a slow tower."""
WATCHED_S = 300.0
"""Seconds after a trial's time limit within which this program decides; after that it has died."""
RETURN_S = 600.0
"""Seconds for the previous release to be ready again; its kernels are compiled."""


@dataclass(frozen=True)
class Places:
    """Paths of an installed tower."""

    site: Path = Path("/etc/ltm/site.yaml")
    state: Path = Path("/var/lib/ltm/state")
    copies: Path = Path("/var/lib/ltm/copies")
    user: str = "ltm"
    """User of the service; as root, the checks of a new release run as this user, if it exists."""


class Upgrade:
    """`say` takes a line for each step."""

    def __init__(
        self, releases: Releases, service: SystemdService, places: Places, say: Callable[[str], None], ready_s: float
    ) -> None:
        self._releases, self._service, self._places, self._say = releases, service, places, say
        self._ready_s = ready_s

    def install(self, package: PackageFile) -> None:
        """Run the release of `package`. Raises UpgradeError or another LtmError; then the previous one runs."""
        former = self._releases.current
        if package.version == former:
            raise UpgradeError(f"{package.path}: release {former} is running already")
        self._say(f"unpacking {package.version} ({package.size / 1e6:.0f} MB) beside {former}")
        new = package.version not in self._releases.installed
        package.unpack(self._releases)
        try:
            self._ask(package.version)
            self._change(former, package.version)
        except BaseException:  # a user's Ctrl-C among them
            if new and self._releases.current == former:
                self._releases.remove(package.version)  # else the next `ltm rollback` would go to it
            raise
        self._say(f"{package.version} is ready")

    def go_back(self, version: str = "") -> str:
        """Run the previous release (or `version`) again; return it. Raises UpgradeError or another LtmError."""
        former = self._releases.current
        target = version or self._releases.other()
        if target == former:
            raise UpgradeError(f"release {target} is running already")
        self._releases.program(target)
        self._change(former, target)
        self._say(f"{target} is ready")
        return target

    def return_unconfirmed(self) -> str | None:
        """Return to the previous release if a release on trial is started a second time; return its version, None
        without a trial. The service is not touched."""
        trial = self._releases.trial
        if trial is None:
            return None
        if self._releases.current == trial.candidate:
            self._put_back(trial)
        self._releases.end_trial()
        return trial.former

    def _change(self, former: str, target: str) -> None:
        begun = time.monotonic()
        self._say(f"stopping {former}")
        try:
            self._service.stop()
            copy = copy_stores(self._places.state, self._places.copies, former)
            self._say(f"the stores are copied to {copy}" if copy else "there are no stores yet")
            watched_s = round(self._ready_s + WATCHED_S)
            self._releases.begin_trial(Trial(former, target, str(copy or ""), watched_s))
        except (LtmError, OSError, KeyboardInterrupt) as error:
            self._service.start()
            why = str(error) or "interrupted"
            raise UpgradeError(f"{target} was rejected: {why}; restarting {former}") from error
        try:
            self._releases.switch(target)
            self._say(f"starting {target}")
            self._service.start()
            wrong = self._wait_until_ready(target, self._ready_s)
        except (LtmError, OSError, KeyboardInterrupt) as error:
            wrong = str(error) or "interrupted"
        if not wrong:
            self._releases.end_trial()
            self._say(f"the tower was down for {time.monotonic() - begun:.0f} s")
            return
        self._say(f"{target}: {wrong}; returning to {former}")
        try:
            try:
                self._service.stop()
            except LtmError as error:
                # Start it whatever is left: for a tower, another start is better than staying down.
                self._say(f"{target} cannot be stopped in order ({error})")
            self.return_unconfirmed()
        finally:
            # Also after a second Ctrl-C, or on a full disk: the guard then returns to the previous release at this
            # start.
            self._service.start()
        state = f"{former} runs again"
        if again := self._wait_until_ready(former, RETURN_S):
            state = f"{former} does not start either ({again}): see `journalctl --namespace=ltm`"
        ready = "is not ready" if again else "is ready"
        self._say(f"{former} {ready} {time.monotonic() - begun:.0f} s after it was stopped")
        raise UpgradeError(f"{target} was rejected: {wrong}; {state}")

    def _put_back(self, trial: Trial) -> None:
        # The stores first: if this is interrupted, the candidate is still current, and everything is repeated.
        if trial.copy:
            aside = self._places.copies.parent / f"stores-of-{trial.candidate}"
            try:
                for store in return_stores(self._places.state, Path(trial.copy), aside):
                    self._say(
                        f"{store.name}: {trial.candidate} had changed its schema; restored the copy, moved the "
                        f"other to {aside}"
                    )
            except (LtmError, OSError) as error:
                # A tower with an empty map is better than one that is down. Nothing is deleted.
                self._say(
                    f"{error}; {trial.former} starts without the missing stores. To restore them: stop the "
                    f"service, copy the files in {trial.copy} to {self._places.state}, start it"
                )
        self._releases.switch(trial.former)

    def _wait_until_ready(self, version: str, limit_s: float) -> str:
        """Return why it did not start; empty: it did."""
        deadline = time.monotonic() + limit_s
        said = ""
        while time.monotonic() < deadline:
            if self._releases.current != version:
                return "ended by itself, and the service's start returned to the previous release"
            state = self._service.state()
            if state.ready:
                return ""
            if state.failed:
                return state.said or "ended by itself"
            said = state.said
            time.sleep(LOOK_S)
        return f"not ready within {limit_s:.0f} s{f' ({said})' if said else ''}"

    def _ask(self, version: str) -> None:
        """Run a check of the new release. Raises UpgradeError with its output; nothing has been changed then."""
        program = self._releases.program(version)
        python = program.with_name("python")
        site = str(self._places.site)
        become, environment = self._as_user()
        questions: list[tuple[str, Sequence[str]]] = [
            ("its installation", [str(program), "doctor"]),
            (f"the site file {site}", [str(program), "check", site]),
            ("its kernels", [str(python), "-m", "ltm_ros.launching.kernels", site]),
        ]
        for what, command in questions:
            begun = time.monotonic()
            try:
                nice = [*become, "nice", "-n", "10", *command]
                program_output(*nice, timeout_s=CHECK_S, cwd="/", env=environment)
            except UpgradeError as error:
                raise UpgradeError(f"{version} was rejected: {what}: {error}; nothing was changed") from error
            self._say(f"{version} accepts {what} ({time.monotonic() - begun:.0f} s)")

    def _as_user(self) -> tuple[list[str], dict[str, str]]:
        """Return the command prefix and environment to run a command as the service's user."""
        environment = {name: value for name, value in os.environ.items() if name in ("PATH", "LANG", "LC_ALL", "HOME")}
        environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
        try:
            user = pwd.getpwnam(self._places.user)
        except KeyError:
            return [], environment
        if os.geteuid() != 0:
            return [], environment
        become = ["setpriv", f"--reuid={user.pw_uid}", f"--regid={user.pw_gid}", "--clear-groups", "--no-new-privs"]
        return become, environment | {"HOME": user.pw_dir}
