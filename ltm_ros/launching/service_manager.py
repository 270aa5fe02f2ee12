"""Report the state of a run to the service manager (sd_notify(3)): ready, alive, problems, stopping.

Messages are datagrams of `NAME=value` lines to the Unix socket `NOTIFY_SOCKET`. Without that variable, nothing is sent.
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
    """Return which processes do not run, and why; else how many run."""
    seen = list(processes)
    down = [process for process in seen if not process.running]
    if not down:
        return f"all {len(seen)} processes run"
    told = ", ".join(_one(process) for process in down)
    line = f"{len(seen) - len(down)} of {len(seen)} processes run; down: {told}"
    return line if len(line) <= LONGEST else f"{line[: LONGEST - 3]}..."


def all_watched(processes: Iterable[NodeProcess]) -> bool:
    """Return whether each process is supervised, restarting, or given up, so that restarting the runner would not help.
    Camera data does not count."""
    return all(process.watched for process in processes)


def _one(process: NodeProcess) -> str:
    if process.state is ProcessState.GIVEN_UP:
        return f"{process.label} (given up, {process.last_exit})"
    return f"{process.label} ({process.last_exit or 'starts'})"


VARIABLES = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
START_EXTENSION_S = 120.0
"""Seconds by which the runner extends its start timeout, repeatedly: compiling kernels can take minutes, and a hung
runner stops extending it."""
SIGNS_A_LIMIT = 3
"""Number of watchdog messages within the manager's watchdog interval."""


class ServiceManager:
    """The service manager that started this process; thread-safe. `address`: socket address; a leading `@` means
    Linux's abstract namespace; None: no manager. `watchdog_s`: seconds without a message after which it restarts the
    service."""

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
        """Return the manager that `environ` names, and remove its variables, so that no child process uses them. Raises
        ConfigError if they are invalid or, when `required`, missing."""
        given = {name: environ.pop(name, "") for name in VARIABLES}
        address, interval, pid = (given[name] for name in VARIABLES)
        if not address:
            if required:
                raise ConfigError(
                    "--notify: NOTIFY_SOCKET is not set; systemd sets it for a unit of Type=notify. Remove --notify"
                )
            return cls()
        if interval and not interval.isdecimal():
            raise ConfigError(f"WATCHDOG_USEC={interval!r}: expected a number of microseconds")
        meant = not pid or pid == str(os.getpid())
        return cls(address, int(interval) / 1e6 if interval and int(interval) and meant else None)

    def starting(self, status: str) -> None:
        """Report that the start is in progress; call it about once a second until `ready`."""
        with self._lock:
            self._tell_status(status)
            if not self._ready and self._is_due(START_EXTENSION_S):
                self._send(f"EXTEND_TIMEOUT_USEC={round(START_EXTENSION_S * 1e6)}")

    def ready(self, status: str) -> None:
        """Report that everything is ready; only the first call sends."""
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
        """Send watchdog messages at the manager's rate; call it about once a second while everything is supervised."""
        with self._lock:
            self._tell_status(status)
            if self._watchdog_s is not None and self._is_due(self._watchdog_s):
                self._send("WATCHDOG=1")

    def status(self, status: str) -> None:
        """Send one line of status for people if it has changed."""
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
        # A manager that does not read must not delay the graph.
        self._socket.setblocking(False)
        try:
            self._socket.connect(f"\0{address[1:]}" if address[0] == "@" else address)
        except OSError as error:
            self._socket.close()
            raise ConfigError(
                f"NOTIFY_SOCKET={address!r}: no service manager listens there ({error.strerror})"
            ) from error

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
            # The manager is busy or restarts (daemon-reexec): the next message comes soon, with the status.
            self._status = ""
            self._sign_at = -float("inf")
