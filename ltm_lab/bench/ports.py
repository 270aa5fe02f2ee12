"""TCP ports of loopback for servers that a trial starts."""

from __future__ import annotations

import random
import socket
from typing import Final

LOOPBACK: Final = "127.0.0.1"
PORTS: Final = range(32_000, 32_768)
"""Below those that Linux gives to connections: while a server is away, or not yet there, none of them takes its port,
and who tries to reach it does not meet itself."""
_held: list[socket.socket] = []


def free_ports(count: int) -> list[int]:
    """Ports on which nobody listens, and that no other trial of this machine is given until this process ends.

    A server of another program cannot be handed a bound socket: what is held in its stead is a name among Linux's
    abstract sockets, which only one process has and which the kernel takes back however that ends. Raises OSError
    where too few are free.
    """
    found: dict[int, socket.socket] = {}
    for port in random.SystemRandom().sample(PORTS, len(PORTS)):
        if len(found) == count:
            break
        if name := _held_name(port):
            found[port] = name
    if len(found) < count:
        for name in found.values():
            name.close()
        raise OSError(f"fewer than {count} of the ports {PORTS.start} to {PORTS.stop - 1} on {LOOPBACK} are free")
    _held.extend(found.values())
    return list(found)


def _held_name(port: int) -> socket.socket | None:
    name = socket.socket(socket.AF_UNIX)
    try:
        name.bind(f"\0ltm-trial-port-{port}")
        with socket.socket() as probe:
            probe.bind((LOOPBACK, port))
    except OSError:
        name.close()
        return None
    return name
