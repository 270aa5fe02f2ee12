"""Report the state of a run to the service manager and to people (sd_notify(3)).

What `ltm run` tells the service manager that started it (sd_notify(3)): ready, alive, what is wrong, stopping.

Datagrams of `NAME=value` lines on the Unix socket that `NOTIFY_SOCKET` names. Without that variable nothing is sent.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterable, MutableMapping

from ltm_core.base.errors import ConfigError
from ltm_ros.launching.supervisor import NodeProcess, ProcessState

LONGEST = 200
"""Characters of a line: service managers show it in one."""


def in_words(processes: Iterable[NodeProcess]) -> str:
    """Which processes do not run, and why; else how many do."""
    seen = list(processes)
    down = [process for process in seen if not process.running]
    if not down:
        return f"all {len(seen)} processes run"
    told = ", ".join(_one(process) for process in down)
    line = f"{len(seen) - len(down)} of {len(seen)} processes run; down: {told}"
    return line if len(line) <= LONGEST else f"{line[: LONGEST - 3]}..."


def all_watched(processes: Iterable[NodeProcess]) -> bool:
    """Whether each process is followed, on its way back, or given up: nothing that a restart of the runner would mend.

    What a camera sends does not matter: one that is offline must not restart the tower.
    """
    return all(process.watched for process in processes)


def _one(process: NodeProcess) -> str:
    if process.state is ProcessState.GIVEN_UP:
        return f"{process.label} (given up, {process.last_exit})"
    return f"{process.label} ({process.last_exit or 'starts'})"


VARIABLES = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
START_EXTENSION_S = 120.0
"""While it starts, the runner asks for that much more time, again and again: kernels may be compiled for minutes, and a
runner that hangs meanwhile asks no more."""
SIGNS_A_LIMIT = 3
"""Signs of life within the time after which the manager takes the service for dead."""


class ServiceManager:
    """Whoever started this process and waits to hear of it; safe to use from several threads.

    Args:
        address: of its socket; a leading `@` stands for Linux's abstract namespace. None: there is no manager.
        watchdog_s: seconds without a sign of life after which it restarts the service; None: it does not.
    """

    def __init__(self, address: str | None = None, watchdog_s: float | None = None) -> None:
        self._lock = threading.Lock()
        self._watchdog_s = watchdog_s
        self._socket: socket.socket | None = None
        self._ready = False
        self._stopping = False
        self._status = ""
        self._sign_at = -float("inf")
        if address is not None:
            self._connect(address)

    @classmethod
    def of_environment(cls, environ: MutableMapping[str, str], *, required: bool = False) -> ServiceManager:
        """The manager that `environ` names; takes its variables out, so that no child speaks for this process.

        Raises ConfigError where the variables make no sense or, when `required`, where there is no manager.
        """
        given = {name: environ.pop(name, "") for name in VARIABLES}
        address, interval, pid = (given[name] for name in VARIABLES)
        if not address:
            if required:
                raise ConfigError(
                    "--notify: NOTIFY_SOCKET is not set: systemd sets it for a unit of Type=notify; leave --notify out"
                )
            return cls()
        if interval and not interval.isdecimal():
            raise ConfigError(f"WATCHDOG_USEC={interval!r}: expected a number of microseconds")
        meant = not pid or pid == str(os.getpid())
        return cls(address, int(interval) / 1e6 if interval and int(interval) and meant else None)

    def starting(self, status: str) -> None:
        """On the way to `ready`; call it about once a second."""
        with self._lock:
            self._tell_status(status)
            if not self._ready and self._is_due(START_EXTENSION_S):
                self._send(f"EXTEND_TIMEOUT_USEC={round(START_EXTENSION_S * 1e6)}")

    def ready(self, status: str) -> None:
        """All is up; only the first time says so."""
        with self._lock:
            if not self._ready and not self._stopping:
                self._ready = True
                self._sign_at = -float("inf")
                self._status = status
                self._send("READY=1", f"STATUS={status}")

    @property
    def is_ready(self) -> bool:
        return self._ready

    def alive(self, status: str) -> None:
        """A sign of life, as often as the manager wants one; call it about once a second while all is watched over."""
        with self._lock:
            self._tell_status(status)
            if self._watchdog_s is not None and self._is_due(self._watchdog_s):
                self._send("WATCHDOG=1")

    def status(self, status: str) -> None:
        """One line for a person; sent when it has changed."""
        with self._lock:
            self._tell_status(status)

    def stopping(self) -> None:
        with self._lock:
            if not self._stopping:
                self._stopping = True
                self._send("STOPPING=1", "STATUS=stopping")

    def close(self) -> None:
        with self._lock:
            if self._socket is not None:
                self._socket.close()
            self._socket = None

    def _connect(self, address: str) -> None:
        if address[:1] not in ("/", "@"):
            raise ConfigError(f"NOTIFY_SOCKET={address!r}: expected a path or @name of a Unix socket")
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        # A manager that does not read must not hold up the graph.
        self._socket.setblocking(False)
        try:
            self._socket.connect(f"\0{address[1:]}" if address[0] == "@" else address)
        except OSError as error:
            self._socket.close()
            raise ConfigError(f"NOTIFY_SOCKET={address!r}: nobody listens there ({error.strerror})") from error

    def _is_due(self, limit_s: float) -> bool:
        now = time.monotonic()
        if now - self._sign_at < limit_s / SIGNS_A_LIMIT:
            return False
        self._sign_at = now
        return True

    def _tell_status(self, status: str) -> None:
        if status != self._status and not self._stopping:
            self._status = status
            self._send(f"STATUS={status}")

    def _send(self, *lines: str) -> None:
        if self._socket is None:
            return
        try:
            # A line break would begin another assignment.
            self._socket.send("\n".join(line.replace("\n", " ") for line in lines).encode(errors="replace"))
        except OSError:
            # The manager is busy or restarts (daemon-reexec): the next sign comes soon, the same status once more.
            self._status = ""
            self._sign_at = -float("inf")
