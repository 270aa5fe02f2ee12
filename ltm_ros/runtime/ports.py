"""TCP ports of this machine: whether they can be listened on, and what to do where not."""

from __future__ import annotations

import errno
import socket


def bind_error(address: str, port: int) -> OSError | None:
    """Why a port cannot be listened on now; None: it can."""
    with socket.socket(socket.AF_INET6 if ":" in address else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((address, port))
        except OSError as error:
            return error
    return None


def refusal(address: str, port: int, error: OSError) -> str:
    """What is wrong where the port of health cannot be listened on, and what to do."""
    remedy = {
        errno.EADDRINUSE: f"end what uses it (`ss -ltnp 'sport = :{port}'` names it), or name another",
        errno.EADDRNOTAVAIL: "this machine has no such address now: is that network up? Else name one that it has",
        errno.EACCES: "ports below 1024 need rights that a service lacks: name a higher one",
    }.get(error.errno or 0, "name another")
    return (
        f"{address}:{port} cannot be listened on ({error.strerror}): {remedy} in `health: {{port: ..., address: ...}}`"
    )
