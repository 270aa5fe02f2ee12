"""Report the state of a run to the service manager (sd_notify(3)): ready, alive, status, stopping.

Messages are datagrams of `NAME=value` lines to the Unix socket `NOTIFY_SOCKET`. Without that variable, nothing is sent.
"""

import contextlib
import os
import socket
import time
from collections.abc import Iterable, MutableMapping

from ltm_core.base.errors import ConfigError
from ltm_ros.launching.supervisor import NodeProcess

LONGEST = 200
"""Characters of a line: service managers show it in one."""
VARIABLES = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
START_EXTENSION_S = 120.0
"""Seconds by which the runner extends its start timeout, repeatedly: compiling kernels can take minutes, and a hung
runner stops extending it."""
SIGNS_A_LIMIT = 3
"""Number of watchdog messages within the manager's watchdog interval."""


def in_words(processes: Iterable[NodeProcess]) -> str:
    """Return which processes do not run, and why, with the last line of one that cannot start; else how many run."""
    seen = list(processes)
    down = []
    for one in seen:
        if not one.running:
            said = list(one.last_words)[-1:] if one.failing else []
            down.append(f"{one.label} ({'; '.join([one.last_exit or 'starts', *said])})")
    if not down:
        return f"all {len(seen)} processes run"
    line = f"{len(seen) - len(down)} of {len(seen)} processes run; down: {', '.join(down)}"
    return line if len(line) <= LONGEST else f"{line[: LONGEST - 3]}..."


class ServiceManager:
    """The service manager that started this process. `address`: socket address; a leading `@` means Linux's abstract
    namespace; empty: no manager. `watchdog_s`: seconds without a message after which it restarts the service. Raises
    ConfigError if nothing listens at the address."""

    def __init__(self, address: str = "", watchdog_s: float | None = None) -> None:
        self._watchdog_s = watchdog_s
        self._ready = self._stopping = False
        self._status = ""
        self._sign_at = -float("inf")
        self._socket: socket.socket | None = None
        if not address:
            return
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        # A manager that does not read must not delay the graph.
        self._socket.setblocking(False)
        try:
            self._socket.connect(f"\0{address[1:]}" if address[0] == "@" else address)
        except OSError as error:
            self._socket.close()
            raise ConfigError(
                f"NOTIFY_SOCKET={address!r}: no service manager listens there ({error.strerror}); unset it"
            ) from error

    @classmethod
    def of_environment(cls, environ: MutableMapping[str, str]) -> "ServiceManager":
        """Return the manager that `environ` names, and remove its variables, so that no child process uses them."""
        address, interval, pid = (environ.pop(name, "") for name in VARIABLES)
        meant = interval.isdecimal() and int(interval) and pid in ("", str(os.getpid()))
        return cls(address, int(interval) / 1e6 if meant else None)

    def report(self, status: str, ready: bool, alive: bool) -> None:
        """Report one line of status if it has changed, and the state of the run; call it about once a second.

        Until it is `ready`, which is sent once, the start timeout is extended; then watchdog messages are sent at the
        manager's rate, while it is `alive`."""
        lines = [f"STATUS={status}"] if status != self._status else []
        if ready and not self._ready:
            lines.insert(0, "READY=1")
            self._sign_at = -float("inf")
        elif alive:
            limit_s = self._watchdog_s if ready else START_EXTENSION_S
            if limit_s is not None and time.monotonic() - self._sign_at >= limit_s / SIGNS_A_LIMIT:
                self._sign_at = time.monotonic()
                lines.append("WATCHDOG=1" if ready else f"EXTEND_TIMEOUT_USEC={round(START_EXTENSION_S * 1e6)}")
        if lines and self._send(*lines):
            self._ready, self._status = ready, status

    def stopping(self) -> None:
        """Report that the run ends; further calls have no effect."""
        if not self._stopping:
            self._stopping = True
            self._send("STOPPING=1", "STATUS=stopping")
            if self._socket is not None:
                self._socket.close()
            self._socket = None

    def _send(self, *lines: str) -> bool:
        """Return whether the manager got it; else it is busy or restarts (daemon-reexec), and the next message has
        everything again."""
        with contextlib.suppress(OSError):
            # A line break would begin another assignment.
            text = "\n".join(line.replace("\n", " ") for line in lines).encode(errors="replace")
            return self._socket is not None and self._socket.send(text) > 0
        self._sign_at = -float("inf")
        return False
