"""Changes the release that a tower runs, and goes back by itself where the new one does not come up.

The order: unpack beside the others; ask the new release whether it finds what it needs, takes the site file and can
compile its kernels, while the former one still works; stop; copy the stores; switch; start; wait for READY. What fails
before the switch changes nothing. What fails after it brings the former release back.
"""

from __future__ import annotations

import os
import pwd
import subprocess  # nosec B404 # argument lists, no shell
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ltm_core.base.errors import LtmError
from ltm_ros.tower.releases import PackageFile, Releases, Trial
from ltm_ros.tower.store_copy import Service, copy_stores, return_stores

LOOK_S = 0.5
CHECK_S = 1800.0
"""For each question to a new release; compiling its kernels takes minutes on a slow tower."""
WATCHED_S = 300.0
"""Longer than that this program takes to judge a release once its time is up: then it is gone itself."""
STOP_S = 25.0
"""For a release that is not taken, to stop in order; then it is killed. The runner gives its processes 10 s."""
RETURN_S = 600.0
"""For the former release to be ready again; its kernels are compiled."""


class UpgradeError(LtmError):
    """A release that was not taken; the former one runs, or is said not to."""


@dataclass(frozen=True)
class Places:
    """Of an installed tower."""

    site: Path = Path("/etc/ltm/site.yaml")
    state: Path = Path("/var/lib/ltm/state")
    copies: Path = Path("/var/lib/ltm/copies")
    user: str = "ltm"
    """Who runs the service; questions to a new release are asked as this user, where it is there and we are root."""


class Upgrade:
    """`say` takes a line for each step."""

    def __init__(
        self, releases: Releases, service: Service, places: Places, say: Callable[[str], None], ready_s: float = 600.0
    ) -> None:
        self._releases, self._service, self._places, self._say = releases, service, places, say
        self._ready_s = ready_s

    def install(self, package: PackageFile) -> None:
        """Run the release of `package`. Raises UpgradeError or another LtmError; then the former one runs."""
        former = self._releases.current
        if package.version == former:
            raise UpgradeError(f"{package.path}: release {former} runs already")
        self._say(f"unpacking {package.version} ({package.size / 1e6:.0f} MB) beside {former}")
        new = package.version not in self._releases.installed
        package.unpack(self._releases)
        try:
            self._ask(package.version)
            self._change(former, package.version)
        except BaseException:  # somebody's Ctrl-C among them
            if new and self._releases.current == former:
                self._releases.remove(package.version)  # else the next `ltm rollback` would go to it
            raise
        self._say(f"{package.version} is ready")

    def go_back(self, version: str = "") -> str:
        """Run the former release (or `version`) again; which that is. Raises UpgradeError or another LtmError."""
        former = self._releases.current
        target = version or self._releases.other()
        if target == former:
            raise UpgradeError(f"release {target} runs already")
        self._releases.program(target)
        self._change(former, target)
        self._say(f"{target} is ready")
        return target

    def return_unconfirmed(self) -> str | None:
        """What the service's start asks for when a release on trial is started a second time: the former one is made
        current again; which that is, or None where nothing is on trial. The service is not touched.
        """
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
            raise UpgradeError(f"{target} was not taken: {why}; {former} is started again") from error
        try:
            self._releases.switch(target)
            self._say(f"starting {target}")
            self._service.start()
            wrong = self._wait_until_ready(target, self._ready_s)
        except (LtmError, OSError) as error:
            wrong = str(error)
        except KeyboardInterrupt:
            wrong = "interrupted"
        if not wrong:
            self._releases.end_trial()
            self._say(f"the tower stood still for {time.monotonic() - begun:.0f} s")
            return
        self._say(f"{target}: {wrong}; going back to {former}")
        try:
            try:
                self._service.stop(STOP_S)
            except LtmError as error:
                # Whatever is left of it: to stand still for good is worse for a tower than to be started once more.
                self._say(f"{target} cannot be stopped in order ({error})")
            self.return_unconfirmed()
        finally:
            # Also after a second Ctrl-C, or on a full disk: this start returns to the former one as well, by the guard.
            self._service.start()
        again = self._wait_until_ready(former, RETURN_S)
        self._say(
            f"{former} {'is not ready' if again else 'is ready'} {time.monotonic() - begun:.0f} s after it was stopped"
        )
        state = f"{former} does not come up either ({again}): see `journalctl --namespace=ltm`"
        raise UpgradeError(f"{target} was not taken: {wrong}; {state if again else f'{former} runs again'}")

    def _put_back(self, trial: Trial) -> None:
        # The stores first: where that is cut short, the candidate is still current, and all of it is done again.
        if trial.copy:
            aside = self._places.copies.parent / f"stores-of-{trial.candidate}"
            try:
                for store in return_stores(self._places.state, Path(trial.copy), aside):
                    self._say(
                        f"{store.name}: {trial.candidate} had changed its schema; the copy is back, the other in "
                        f"{aside}"
                    )
            except (LtmError, OSError) as error:
                # A tower that begins with an empty map is more than one that stands still: nothing is deleted.
                self._say(
                    f"{error}; {trial.former} starts without what is missing. To have it again: stop the service, copy "
                    f"what lies in {trial.copy} to {self._places.state}, start it"
                )
        self._releases.switch(trial.former)

    def _wait_until_ready(self, version: str, limit_s: float) -> str:
        """Why it did not come up; empty: it did."""
        deadline = time.monotonic() + limit_s
        said = ""
        while time.monotonic() < deadline:
            if self._releases.current != version:
                return "ended by itself and was taken back by the service's start"
            state = self._service.state()
            if state.ready:
                return ""
            if state.failed:
                return state.said or "ended by itself"
            said = state.said
            time.sleep(LOOK_S)
        return f"not ready within {limit_s:.0f} s{f' ({said})' if said else ''}"

    def _ask(self, version: str) -> None:
        """Raises UpgradeError with what the new release says is wrong; nothing has been changed then."""
        program = self._releases.program(version)
        python = program.with_name("python")
        site = str(self._places.site)
        become, environment = self._as_user()
        questions: list[tuple[str, Sequence[str]]] = [
            ("its installation", [str(program), "doctor"]),
            (f"the site file {site}", [str(program), "check", site]),
            ("its kernels", [str(python), "-m", "ltm_ros.tower.compile_kernels", site]),
        ]
        for what, command in questions:
            begun = time.monotonic()
            try:
                ran = subprocess.run(  # nosec B603 # no shell
                    [*become, "nice", "-n", "10", *command],
                    capture_output=True,
                    text=True,
                    errors="replace",
                    timeout=CHECK_S,
                    cwd="/",
                    env=environment,
                )
            except (OSError, subprocess.TimeoutExpired) as error:
                raise UpgradeError(f"{version} is not taken: {what}: {error}; nothing was changed") from error
            lines = [line for line in (ran.stdout + ran.stderr).splitlines() if line.strip()]
            if ran.returncode:
                said = "; ".join(lines[-3:]) or f"exit code {ran.returncode}"
                raise UpgradeError(f"{version} is not taken: {what}: {said}; nothing was changed")
            self._say(f"{version} finds {what} as it should be ({time.monotonic() - begun:.0f} s)")

    def _as_user(self) -> tuple[list[str], dict[str, str]]:
        """What goes before a command so that the service's user runs it, and the environment."""
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
