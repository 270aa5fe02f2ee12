"""The service that runs a tower, as far as upgrades need it: stopped, started, ready or not."""

from __future__ import annotations

import subprocess  # nosec B404 # argument lists, no shell
import time
from dataclasses import dataclass
from typing import Protocol

from ltm_core.base.errors import LtmError

UNIT = "ltm.service"
LOOK_S = 0.5


class ServiceError(LtmError):
    """A service that cannot be asked, stopped or started."""


@dataclass(frozen=True)
class ServiceState:
    ready: bool
    """All its nodes have been up since it was started."""
    failed: bool
    """It has ended by itself since it was started, whether it is started again or not."""
    said: str
    """Its own word, for a person."""


class Service(Protocol):
    """Start returns at once; `state` says how that goes. Stop kills what has not ended after `patience_s` seconds;
    None: after the time that the unit itself gives."""

    def stop(self, patience_s: float | None = None) -> None: ...

    def start(self) -> None: ...

    def state(self) -> ServiceState: ...


class SystemdService:
    """By systemctl, whose word on Type=notify is the service's own READY=1."""

    def stop(self, patience_s: float | None = None) -> None:
        if patience_s is not None:
            _systemctl("stop", "--no-block", UNIT)
            deadline = time.monotonic() + patience_s
            while self._runs() and time.monotonic() < deadline:
                time.sleep(LOOK_S)
            if self._runs():
                _systemctl("kill", "--signal=KILL", UNIT, check=False)
        _systemctl("stop", UNIT)  # returns once it has ended

    def _runs(self) -> bool:
        return _systemctl("show", UNIT, "--property=ActiveState", "--value").strip() not in ("inactive", "failed")

    def start(self) -> None:
        _systemctl("reset-failed", UNIT, check=False)  # also sets the number of restarts to 0
        _systemctl("start", "--no-block", UNIT)

    def state(self) -> ServiceState:
        names = ("ActiveState", "SubState", "NRestarts", "Result", "StatusText", "ExecMainStatus")
        said = _systemctl("show", UNIT, f"--property={','.join(names)}")
        fields = dict(line.partition("=")[::2] for line in said.splitlines())
        again = fields.get("SubState") == "auto-restart" or fields.get("NRestarts", "0") != "0"
        failed = again or fields.get("ActiveState") == "failed"
        text = fields.get("StatusText") or ""
        if failed:
            text = f"{fields.get('Result')}, exit code {fields.get('ExecMainStatus')}{f': {text}' if text else ''}"
        return ServiceState(fields.get("ActiveState") == "active" and not again, failed, text)


def _systemctl(*arguments: str, check: bool = True) -> str:
    try:
        ran = subprocess.run(  # nosec B603 B607 # no shell; root's own PATH
            ["systemctl", *arguments], capture_output=True, text=True, errors="replace", timeout=300
        )
    except (FileNotFoundError, subprocess.TimeoutExpired) as error:
        raise ServiceError(
            f"systemctl {' '.join(arguments)}: {error}: the tower's service runs under systemd"
        ) from error
    if check and ran.returncode:
        raise ServiceError(f"systemctl {' '.join(arguments)}: {ran.stderr.strip() or f'exit code {ran.returncode}'}")
    return ran.stdout
